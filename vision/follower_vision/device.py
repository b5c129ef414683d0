"""Which processor networks run on: onnxruntime's execution providers, by the names people know.

A name is the provider's own in small letters: cpu, cuda, tensorrt, openvino, coreml, qnn, and so on
(https://onnxruntime.ai/docs/execution-providers/). Which of them there are depends on the
onnxruntime that is installed: onnxruntime-gpu has CUDA and TensorRT, onnxruntime-openvino OpenVINO.
"""

import os
import tempfile
from pathlib import Path

import onnxruntime

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
