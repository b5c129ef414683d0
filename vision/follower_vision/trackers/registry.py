"""The motion trackers by name."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeAlias

from follower_vision.onnx_network import CPU, path_of
from follower_vision.trackers.correlation import CorrelationTracker
from follower_vision.trackers.motion_tracker import IdentityTracker, JoinedTracker, MotionTracker
from follower_vision.trackers.nanotrack import (
    NANOTRACK_SETTINGS,
    SIAMESE_SETTINGS,
    NanoTracker,
    NanoTrackNetwork,
    NanoTrackSettings,
)
from follower_vision.trackers.opencv import OPENCV_KINDS, OpenCvTracker, opencv_tracker_names
from follower_vision.trackers.plugin_tracker import TRACKER_PLUGINS, guarded
from follower_vision.trackers.re3 import Re3Network, Re3Tracker

FindFile: TypeAlias = Callable[[str], Path]
"""Gives the path of a network's file by its name, as `ModelStore.file` does."""

RE3_FILE = "follower-re3.onnx"
_NETWORK = ".onnx"
_BACKBONE, _HEAD = "_backbone.onnx", "_head.onnx"


def _nanotrack(
    name: str, settings: NanoTrackSettings, find_file: FindFile, device: str
) -> NanoTracker:
    backbone, head = network_files(name, find_file)
    stem = head.name.removesuffix(_HEAD) if name.endswith(_HEAD) else name
    return NanoTracker(NanoTrackNetwork(backbone, head, device), settings, stem)


_siamese = partial(_nanotrack, "siamese", SIAMESE_SETTINGS)


def _joined(find_file: FindFile, device: str) -> JoinedTracker:
    return JoinedTracker(_siamese(find_file, device), CorrelationTracker())


def _re3(find_file: FindFile, device: str) -> Re3Tracker:
    return Re3Tracker(Re3Network(find_file(RE3_FILE), device))


def _opencv(name: str, find_file: FindFile, _device: str) -> OpenCvTracker:
    return OpenCvTracker(name, find_file)


TRACKERS: dict[str, Callable[[FindFile, str], MotionTracker]] = {
    "identity": lambda _file, _device: IdentityTracker(),
    "correlation": lambda _file, _device: CorrelationTracker(),
    "siamese": _siamese,
    "siamese-correlation": _joined,
    **{
        f"nanotrack-v{number}": partial(_nanotrack, f"nanotrack-v{number}", settings)
        for number, settings in NANOTRACK_SETTINGS.items()
    },
    "re3": _re3,
    **{name: partial(_opencv, name) for name in OPENCV_KINDS},
}
"""How each is made; trackers that have no network ask for no file. Plug-ins come beside them."""

_FILES: dict[str, tuple[str, ...]] = {
    **{
        f"nanotrack-v{number}": tuple(f"nanotrackv{number}{part}" for part in (_BACKBONE, _HEAD))
        for number in NANOTRACK_SETTINGS
    },
    **dict.fromkeys(
        ("siamese", "siamese-correlation"),
        tuple(f"follower-siamese{part}" for part in (_BACKBONE, _HEAD)),
    ),
    "re3": (RE3_FILE,),
    **{name: tuple(kind.files.values()) for name, kind in OPENCV_KINDS.items()},
}
"""What each asks for."""


def network_files(name: str, find_file: FindFile) -> list[Path]:
    """Return the networks that `make_tracker` loads for a name; of another package's none is known.

    Raises:
        ModelError: `find_file` does not find one.
    """
    if name.endswith(_HEAD):
        head = path_of(name)
        return [head.with_name(head.name.removesuffix(_HEAD) + _BACKBONE), head]
    if name.endswith(_NETWORK):
        return [path_of(name)]
    return [find_file(file) for file in _FILES.get(name, ())]


def tracker_names() -> list[str]:
    """Return the names that `make_tracker` takes here; OpenCV's depend on how it was built.

    Those of other packages come last.
    """
    return [*_own_names(), *TRACKER_PLUGINS.names(TRACKERS)]


def is_tracker(name: str) -> bool:
    """Return whether `make_tracker` takes a name: one of `tracker_names()`, or a file's path.

    Raises:
        PluginError: two packages have a tracker of that name.
    """
    if name in TRACKERS:
        return name in _own_names()
    return name.endswith(_NETWORK) or TRACKER_PLUGINS.find(name) is not None


def _own_names() -> list[str]:
    missing = OPENCV_KINDS.keys() - opencv_tracker_names()
    return [name for name in TRACKERS if name not in missing]


def make_tracker(name: str, find_file: FindFile, device: str = CPU) -> MotionTracker:
    """Return a motion tracker, not yet started.

    Args:
        name: one of `tracker_names()`, or the path of a network that `follower train re3` wrote,
            or of the head of one that `follower train siamese` did.
        find_file: asked only by trackers that have networks.
        device: where networks run; see `device`.

    Raises:
        ValueError: there is no tracker of that name, or this OpenCV lacks it.
        ModelError: a network's file is missing or broken.
        PluginError: another package's tracker cannot be used.
    """
    if name.endswith(_HEAD):
        return _nanotrack(name, SIAMESE_SETTINGS, find_file, device)
    if name.endswith(_NETWORK):
        return Re3Tracker(Re3Network(path_of(name), device), name=Path(name).stem)
    if name in TRACKERS:
        return TRACKERS[name](find_file, device)
    plugin = TRACKER_PLUGINS.find(name)
    if plugin is None:
        raise ValueError(f"there is no tracker {name!r}; there are {', '.join(tracker_names())}")
    return guarded(plugin.make(find_file, device), plugin)
