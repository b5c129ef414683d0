"""The motion trackers by name."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from follower_vision.motion import IdentityTracker, MotionTracker
from follower_vision.nanotrack import NanoTracker
from follower_vision.nanotrack_network import NanoTrackNetwork
from follower_vision.nanotrack_settings import NANOTRACK_SETTINGS
from follower_vision.opencv_trackers import OPENCV_KINDS, OpenCvTracker, opencv_tracker_names
from follower_vision.re3 import Re3Tracker
from follower_vision.re3_network import Re3Network

RE3_FILE = "follower-re3.onnx"
_RE3 = "re3"
_NETWORK = ".onnx"
_NANOTRACK = {f"nanotrack-v{version}": version for version in NANOTRACK_SETTINGS}


def tracker_names() -> list[str]:
    """Return the names that `make_tracker` takes here; OpenCV's depend on how it was built."""
    return ["identity", "correlation", *_NANOTRACK, _RE3, *opencv_tracker_names()]


def is_tracker(name: str) -> bool:
    """Return whether `make_tracker` takes a name: one of `tracker_names()`, or a file's path."""
    return name in tracker_names() or name.endswith(_NETWORK)


def make_tracker(name: str, find_file: Callable[[str], Path]) -> MotionTracker:
    """Return a motion tracker, not yet started.

    Args:
        name: one of `tracker_names()`, or the path of a network that `follower train re3` wrote.
        find_file: gives the path of a network's file by its name, as `ModelStore.file` does; it
            is asked only by trackers that have networks.

    Raises:
        ValueError: nobody knows the name, or this OpenCV lacks it.
        ModelError: a network's file is missing or broken.
    """
    if name == "identity":
        return IdentityTracker()
    if name == "correlation":
        return _correlation()
    if name == _RE3:
        return Re3Tracker(Re3Network(find_file(RE3_FILE)))
    if name.endswith(_NETWORK):
        return Re3Tracker(Re3Network(Path(name)), name=Path(name).stem)
    if name in _NANOTRACK:
        return _nanotrack(_NANOTRACK[name], find_file)
    if name in OPENCV_KINDS:
        return OpenCvTracker(name, find_file)
    raise ValueError(f"there is no tracker {name!r}; there are {', '.join(tracker_names())}")


def _correlation() -> MotionTracker:
    tracker: MotionTracker = import_module("follower_vision.correlation").CorrelationTracker()
    return tracker


def _nanotrack(version: int, find_file: Callable[[str], Path]) -> NanoTracker:
    network = NanoTrackNetwork(
        find_file(f"nanotrackv{version}_backbone.onnx"), find_file(f"nanotrackv{version}_head.onnx")
    )
    return NanoTracker(network, NANOTRACK_SETTINGS[version], f"nanotrack-v{version}")
