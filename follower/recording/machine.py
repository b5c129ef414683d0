"""The machine on which a flight is recorded or replayed: what decides about the last bits.

The C library, NumPy, OpenBLAS, OpenCV and onnxruntime choose code by the processor's instruction
sets, which rounds otherwise; another version may do so too.
"""

import platform
import sys
from collections.abc import Mapping
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_info

OWN = "drone-target-follower"
_PACKAGES = (OWN, "numpy", "opencv-python-headless", "onnxruntime", "filterpy", "av")
_UNNAMED = "the recording does not name its processor"


def running_versions() -> dict[str, str]:
    """Return the versions of what computes: the same ones give the same flight."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    found["system"] = sys.platform
    found["libc"] = " ".join(platform.libc_ver()).strip() or "unknown"
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def running_processor() -> dict[str, str]:
    """Return the processor's model, the features by which NumPy chooses, and its BLAS' kernels."""
    libraries = [one for one in threadpool_info() if "numpy" in one.get("filepath", "")]
    kernels = {str(one["architecture"]) for one in libraries if one.get("architecture")}
    return {
        "model": _model(),
        "features": " ".join(processor_features()),
        "blas": " ".join(sorted(kernels)),
    }


def processor_features() -> list[str]:
    """Return the instruction sets that NumPy was built for and those that it found besides."""
    known = np.show_config(mode="dicts").get("SIMD Extensions", {})
    return [*known.get("baseline", ()), *known.get("found", ())]


def machine_differences(versions: Mapping[str, str], processor: Mapping[str, str]) -> list[str]:
    """Return in words why numbers of a recording may be others here in their last bits; [] if not.

    Args:
        versions: as recorded.
        processor: as recorded; empty in recordings from before it was.
    """
    if not processor:
        return [_UNNAMED]
    now = running_processor()
    kinds = [
        f"processor {name} {now[name] or 'none'}, recorded with {processor.get(name) or 'none'}"
        for name in ("features", "blas")
        if processor.get(name, "") != now[name]
    ]
    return kinds + changed_versions({k: v for k, v in versions.items() if k != OWN})


def changed_versions(recorded: Mapping[str, str]) -> list[str]:
    """Return in words which versions are others today."""
    now = running_versions()
    names = [name for name in now if name in recorded and recorded[name] != now[name]]
    return [f"{name} {now[name]}, recorded with {recorded[name]}" for name in names]


def _model() -> str:
    """Return the processor's name, or that of a board whose processor has none."""
    info: dict[str, str] = {}
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines()
        parts = (line.partition(":") for line in lines)
        info = {name.strip(): value.strip() for name, _, value in parts}
    return info.get("model name") or info.get("Model") or platform.processor() or platform.machine()
