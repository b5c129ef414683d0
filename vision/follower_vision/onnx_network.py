"""Neural networks in ONNX files, run by onnxruntime; and their input size changed without `onnx`.

An ONNX file is a protobuf message: a row of fields, each a key (number and wire type) and a value.
Only the few fields that state shapes are rewritten here; everything else is copied byte for byte.
The numbers are those of onnx.proto: a model's graph is field 7, a graph's inputs, outputs and notes
on tensors between them are 11, 12 and 13, a value's name and type 1 and 2.
"""

import logging
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

import numpy as np
import numpy.typing as npt
import onnxruntime
from onnxruntime.capi import onnxruntime_pybind11_state as ort_errors

from follower_vision.user_cache import DeviceVerdict

CPU, AUTO = "cpu", "auto"
_SUFFIX = "ExecutionProvider"
_BEST_FIRST = (
    "tensorrt", "cuda", "migraphx", "rocm", "coreml", "qnn", "rknpu", "cann", "openvino", "dml",
)  # fmt: skip
"""What `auto` tries before the processor, in this order."""
DEVICES = (AUTO, CPU, *_BEST_FIRST)


def provider_of(device: str) -> str:
    """Return the execution provider's name, "" if this onnxruntime has none for the device."""
    offered: list[str] = onnxruntime.get_available_providers()
    return next((name for name in offered if name.removesuffix(_SUFFIX).lower() == device), "")


def accelerators(device: str) -> tuple[str, ...]:
    """Return the devices to try before the processor, best first; none for "cpu".

    Raises:
        ValueError: there is no such device.
    """
    if device not in DEVICES:
        raise ValueError(f"there is no device {device!r}; there are {', '.join(DEVICES)}")
    if device == AUTO:
        return tuple(name for name in _BEST_FIRST if provider_of(name))
    return () if device == CPU else (device,)


def provider_options(device: str, folder: Path) -> dict[str, str]:
    """Return a provider's options: TensorRT keeps the engines that it builds, which takes minutes.

    Args:
        device: whose provider.
        folder: where the network lies; engines go beside it if that can be written.
    """
    if device != "tensorrt":
        return {}
    base = folder if os.access(folder, os.W_OK) else Path(tempfile.gettempdir())
    return {"trt_engine_cache_enable": "1", "trt_engine_cache_path": str(base / "tensorrt")}


Tensor: TypeAlias = npt.NDArray[np.float32]
Integers: TypeAlias = npt.NDArray[np.integer]
Feeds: TypeAlias = Mapping[str, Tensor | Integers]
"""Inputs by name."""

_ERRORS: tuple[type[Exception], ...] = tuple(
    one for one in vars(ort_errors).values() if isinstance(one, type) and issubclass(one, Exception)
)
"""All that onnxruntime raises; which there are depends on its version."""
_OPENING_ERRORS: tuple[type[Exception], ...] = (RuntimeError, ValueError, *_ERRORS)
"""The former, too, where a device's library cannot be loaded."""
_LOGGER = logging.getLogger(__name__)
_ERRORS_ONLY = 3
_WEIGHTS_FOLDER = "session.model_external_initializers_file_folder_path"
_SAME = 0.01
"""Of an output's largest value: half-precision numbers err by a tenth of that."""
_GRAPH, _INPUT, _OUTPUT, _VALUE_NOTES = 7, 11, 12, 13
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_FLOAT = 1
_PICTURE = (1, 3, 416, 416)
_KINDS = {"tensor(float)": np.float32, "tensor(int64)": np.int64, "tensor(int32)": np.int32}


class ModelError(ValueError):
    """A network's file is missing, broken or of another kind; the message is one line.

    Examples:
        >>> import follower
        >>> try:
        ...     follower.Fusion("car", overrides=["detector=gone.onnx"])
        ... except follower.ModelError as error:
        ...     print(error)
        gone.onnx: no such network; ...
    """


_REFUSALS: tuple[type[Exception], ...] = (ModelError, *_ERRORS)


def path_of(name: str) -> Path:
    """Return the path that a user has named, with the home folder for its "~".

    Raises:
        ModelError: there is no such home.
    """
    try:
        return Path(name).expanduser()
    except RuntimeError:
        raise ModelError(f"{name}: there is no such home; write the whole path") from None


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


def onnx_session(path: Path, content: bytes | None = None, device: str = CPU) -> Any:
    """Open an onnxruntime session that does not disturb a control loop beside it.

    It has one thread, which sleeps while it waits: onnxruntime's default is to spin, which takes
    the processor from everybody else.

    Args:
        path: the ONNX file; also the name in error messages. Weights in files of their own lie
            beside it.
        content: the network's bytes, if they are not to be read from `path`.
        device: where it runs; see `device`.

    Raises:
        ModelError: the file is missing or is no network that onnxruntime can run there.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = _ERRORS_ONLY
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.add_session_config_entry("session.inter_op.allow_spinning", "0")
    options.add_session_config_entry(_WEIGHTS_FOLDER, str(path.parent))
    model = read_model(path) if content is None else content
    provider = provider_of(device)
    if not provider:
        raise ModelError(f"{path}: the onnxruntime that is installed has no {device}")
    providers = [(provider, provider_options(device, path.parent))]
    try:
        # By itself it would go on elsewhere, which nobody compared, under the same name.
        session = onnxruntime.InferenceSession(
            model, options, providers=providers, enable_fallback=0
        )
    except _OPENING_ERRORS as error:
        if device != CPU:
            reason = f"{device} does not start here ({_first_line(error)})"
            raise ModelError(f"{path}: {reason}") from error
        raise ModelError(
            f"{path}: not a network that onnxruntime can run ({_first_line(error)}); "
            "fetch it again with `follower models pull NAME` if it is one of ours"
        ) from error
    if provider not in session.get_providers():  # it goes on without one that does not start
        raise ModelError(f"{path}: {device} does not start here")
    return session


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or ["no reason given"])[0]


class Network:
    """A network with float32 tensors in and out; one beside the first may take whole numbers.

    Where another device than the processor is asked for, it has to give the processor's answers
    when the network is loaded; if it does not, or fails later, the processor takes over at once,
    with one warning in the log. The verdict is kept (`DeviceVerdict`): what gave the same answers
    is not compared again, and what was refused is tried again only if it is asked for by its name.

    Attributes:
        path: the file that it came from.
        inputs: name to shape of every input, in order; 0 where a size is free.
        kinds: the inputs' types of numbers, in order.
        outputs: name to shape of every output.
        metadata: what the exporter wrote into the file.
        device: where it runs now; see `device`.
        refusals: why it does not run on the devices that were to be tried before.
        listeners: of all networks, told the file and the inputs before each run.
    """

    listeners: ClassVar[list[Callable[[Path, Feeds], None]]] = []

    def __init__(self, path: Path, device: str = CPU, content: bytes | None = None) -> None:
        """Load the network.

        Args:
            path: the ONNX file; also the name in error messages.
            device: where it is to run.
            content: the network's bytes, if they are not to be read from `path`.

        Raises:
            ModelError: the file is missing, or is no network that onnxruntime can run, or its
                inputs are not float32.
            ValueError: there is no such device.
        """
        content = read_model(path) if content is None else content
        self._session = onnx_session(path, content)
        for number, node in enumerate(self._session.get_inputs()):
            if node.type not in _KINDS or (number == 0 and _KINDS[node.type] is not np.float32):
                refused = f"input {node.name} is a {node.type}; only float32 is taken"
                raise ModelError(f"{path}: {refused}")
        self.path = path
        self.inputs = {node.name: _shape(node) for node in self._session.get_inputs()}
        self.kinds = [_KINDS[node.type] for node in self._session.get_inputs()]
        self.outputs = {node.name: _shape(node) for node in self._session.get_outputs()}
        self.metadata: dict[str, str] = dict(self._session.get_modelmeta().custom_metadata_map)
        self.device, self._accelerated = CPU, None
        self.refusals: dict[str, str] = {}
        for name in accelerators(device):
            try:
                session = self._accelerator(name, content, tries_again=device != AUTO)
            except _REFUSALS as error:
                level = logging.INFO if device == AUTO else logging.WARNING
                why = self.refusals[name] = _first_line(error).removeprefix(f"{path}: ")
                _LOGGER.log(level, "%s runs on the processor: %s", path.name, why)
            else:
                self.device, self._accelerated = name, session
                return

    def run(self, *tensors: Tensor | Integers) -> list[Tensor]:
        """Return the outputs, in order, for the inputs given in order.

        Raises:
            ModelError: the tensors do not fit the network.
        """
        feeds = dict(zip(self.inputs, tensors, strict=True))
        for listener in self.listeners:
            listener(self.path, feeds)
        if self._accelerated is not None:
            try:
                return list(self._accelerated.run(None, feeds))
            except _ERRORS as error:
                text = "%s failed on %s and goes on with the processor: %s"
                _LOGGER.warning(text, self.path.name, self.device, _first_line(error))
                self.device, self._accelerated = CPU, None
        try:
            return list(self._session.run(None, feeds))
        except _ERRORS as error:
            shapes = ", ".join(str(tensor.shape) for tensor in tensors)
            raise ModelError(
                f"{self.path}: this network does not take tensors of shape {shapes} "
                f"({_first_line(error)})"
            ) from error

    def _accelerator(self, device: str, content: bytes, tries_again: bool) -> Any:
        """Open a session on a device that gives the processor's answers.

        Raises:
            ModelError: it does not, or not start; or it did not once and is not tried again.
        """
        verdict = DeviceVerdict(content, device)
        refusal = verdict.read()
        if not refusal or tries_again:
            session = onnx_session(self.path, content, device)
            if refusal != "":
                verdict.write(refusal := self._difference(session))
        if refusal:
            raise ModelError(f"{self.path}: {refusal}")
        return session

    def _difference(self, session: Any) -> str:
        """Return in which output a session differs from the processor, "" if in none."""
        rng = np.random.default_rng(0)
        shapes = map(usual_shape, self.inputs.values())
        feeds = {
            name: rng.random(of, dtype=np.float32) if kind is np.float32 else np.ones(of, kind)
            for name, of, kind in zip(self.inputs, shapes, self.kinds, strict=True)
        }
        wanted, got = self._session.run(None, feeds), session.run(None, feeds)
        for name, a, b in zip(self.outputs, wanted, got, strict=True):
            if not np.allclose(a, b, rtol=0, atol=_SAME * float(np.abs(a).max(initial=0))):
                return f"other answers than the processor's ({name})"
        return ""


def _shape(node: Any) -> tuple[int, ...]:
    return tuple(size if isinstance(size, int) else 0 for size in node.shape)


def usual_shape(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return an input's shape with free sizes, 0, as of one picture of 416 pixels, else 1."""
    usual = _PICTURE if len(shape) == len(_PICTURE) else (1,) * len(shape)
    return tuple(size or one for size, one in zip(shape, usual, strict=True))


def with_input_size(model: bytes, shape: tuple[int, ...]) -> bytes:
    """Return the network with its only input declared as `shape` and its other sizes left open.

    It works for a network whose layers do not themselves hold a size, as convolutions, pooling
    over everything and matrix products over channels do not.

    Raises:
        ValueError: this is no ONNX file, or its graph has other than one input.
    """
    parts = [
        _field(number, _resized_graph(value, shape)) if number == _GRAPH else raw
        for number, value, raw in _fields(model)
    ]
    return b"".join(parts)


def _resized_graph(graph: bytes, shape: tuple[int, ...]) -> bytes:
    inputs = sum(number == _INPUT for number, _, _ in _fields(graph))
    if inputs != 1:
        raise ValueError(f"this network has {inputs} inputs; only one can be given another size")
    return b"".join(
        _resized_field(number, value, raw, shape) for number, value, raw in _fields(graph)
    )


def _resized_field(number: int, value: bytes, raw: bytes, shape: tuple[int, ...]) -> bytes:
    if number == _INPUT:
        return _field(_INPUT, _value_info(_name(value), shape))
    if number == _OUTPUT:
        return _field(_OUTPUT, _value_info(_name(value), None))
    return b"" if number == _VALUE_NOTES else raw


def _value_info(name: bytes, shape: tuple[int, ...] | None) -> bytes:
    """Encode a float tensor's name, type and, if known, shape."""
    tensor = _varint(1 << 3) + _varint(_FLOAT)
    if shape is not None:
        sizes = (_field(1, _varint(1 << 3) + _varint(size)) for size in shape)
        tensor += _field(2, b"".join(sizes))
    return _field(1, name) + _field(2, _field(1, tensor))


def _name(value_info: bytes) -> bytes:
    return next(value for number, value, _ in _fields(value_info) if number == 1)


def _fields(message: bytes) -> Iterator[tuple[int, bytes, bytes]]:
    """Yield number, value (of length-delimited fields) and raw bytes of each field in turn."""
    at = 0
    while at < len(message):
        key, value_at = _read_varint(message, at)
        start, end = _value_span(message, value_at, key & 7)
        if end > len(message):
            raise ValueError("this is no ONNX file: a field reaches beyond the end")
        yield key >> 3, message[start:end], message[at:end]
        at = end


def _value_span(message: bytes, at: int, wire_type: int) -> tuple[int, int]:
    if wire_type == _VARINT:
        return at, _read_varint(message, at)[1]
    if wire_type == _BYTES:
        length, start = _read_varint(message, at)
        return start, start + length
    if wire_type in (_FIXED64, _FIXED32):
        return at, at + (8 if wire_type == _FIXED64 else 4)
    raise ValueError(f"this is no ONNX file: wire type {wire_type}")


def _read_varint(message: bytes, at: int) -> tuple[int, int]:
    """Return the number that starts at `at`, and where it ends."""
    value = shift = 0
    while at < len(message):
        byte = message[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at
    raise ValueError("this is no ONNX file: it ends within a number")


def _varint(value: int) -> bytes:
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _field(number: int, value: bytes) -> bytes:
    return _varint(number << 3 | _BYTES) + _varint(len(value)) + value
