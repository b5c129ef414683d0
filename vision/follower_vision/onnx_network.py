"""Neural networks in ONNX files, run by onnxruntime."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import onnxruntime
from onnxruntime.capi import onnxruntime_pybind11_state as ort_errors

Tensor: TypeAlias = npt.NDArray[np.float32]

_LOAD_ERRORS = (
    ort_errors.Fail,
    ort_errors.InvalidArgument,
    ort_errors.InvalidGraph,
    ort_errors.InvalidProtobuf,
    ort_errors.NotImplemented,
    ort_errors.RuntimeException,
)
_ERRORS_ONLY = 3


class ModelError(ValueError):
    """A network's file is missing, broken or of another kind; the message is one line."""


def check_model(path: Path) -> None:
    """Make sure that a network's file is there.

    Raises:
        ModelError: it is not; the message says how to get it.
    """
    if not path.is_file():
        raise ModelError(
            f"{path}: no such network; `follower models list` shows those known, "
            "`follower models pull NAME` fetches one"
        )


def read_model(path: Path) -> bytes:
    """Return the bytes of a network's file.

    Raises:
        ModelError: the file is missing or cannot be read.
    """
    check_model(path)
    try:
        return path.read_bytes()
    except OSError as error:
        raise ModelError(f"{path}: cannot read this network: {error.strerror}") from error


def onnx_session(path: Path, threads: int = 1, content: bytes | None = None) -> Any:
    """Open an onnxruntime session that does not disturb a control loop beside it.

    Its threads sleep while they wait: onnxruntime's default is to spin, which takes the processor
    from everybody else.

    Args:
        path: the ONNX file; also the name in error messages.
        threads: processor threads that one inference may use.
        content: the network's bytes, if they are not to be read from `path`.

    Raises:
        ModelError: the file is missing or is no network that onnxruntime can run.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = _ERRORS_ONLY
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.add_session_config_entry("session.inter_op.allow_spinning", "0")
    model = read_model(path) if content is None else content
    try:
        return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    except _LOAD_ERRORS as error:
        raise ModelError(
            f"{path}: not a network that onnxruntime can run ({_first_line(error)}); "
            "fetch it again with `follower models pull NAME` if it is one of ours"
        ) from error


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or ["no reason given"])[0]


class Network:
    """A network with float32 tensors in and out.

    Attributes:
        path: the file that it came from.
        inputs: name to shape of every input, in order; 0 where a size is free.
        outputs: the same of every output.
        metadata: what the exporter wrote into the file.
    """

    def __init__(self, path: Path, threads: int = 1, content: bytes | None = None) -> None:
        """Load the network.

        Args:
            path: the ONNX file; also the name in error messages.
            threads: processor threads that one inference may use.
            content: the network's bytes, if they are not to be read from `path`.

        Raises:
            ModelError: the file is missing, or is no network that onnxruntime can run, or its
                inputs are not float32.
        """
        self._session = onnx_session(path, threads, content)
        _check_types(path, self._session.get_inputs())
        self.path = path
        self.inputs = {node.name: _shape(node) for node in self._session.get_inputs()}
        self.outputs = {node.name: _shape(node) for node in self._session.get_outputs()}
        self.metadata: dict[str, str] = dict(self._session.get_modelmeta().custom_metadata_map)

    def run(self, *tensors: Tensor) -> list[Tensor]:
        """Return the outputs, in order, for the inputs given in order.

        Raises:
            ModelError: the tensors do not fit the network.
        """
        feeds = dict(zip(self.inputs, tensors, strict=True))
        try:
            return list(self._session.run(None, feeds))
        except (ort_errors.InvalidArgument, ort_errors.Fail, ort_errors.RuntimeException) as error:
            shapes = ", ".join(str(tensor.shape) for tensor in tensors)
            raise ModelError(
                f"{self.path}: this network does not take tensors of shape {shapes} "
                f"({_first_line(error)})"
            ) from error


def _check_types(path: Path, inputs: list[Any]) -> None:
    for node in inputs:
        if node.type != "tensor(float)":
            raise ModelError(f"{path}: input {node.name} is a {node.type}; only float32 is taken")


def _shape(node: Any) -> tuple[int, ...]:
    return tuple(size if isinstance(size, int) else 0 for size in node.shape)
