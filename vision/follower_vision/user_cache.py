"""The user's cache: its folder, and on which devices networks gave the processor's answers."""

import hashlib
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import onnxruntime

from follower_vision.disk import write_whole

_SAME, _REFUSED = "same answers", "refused: "


def cache_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Return follower's folder in the user's cache, which need not exist."""
    cache = environment.get("XDG_CACHE_HOME")
    # The XDG specification says to ignore a path that is not absolute.
    if cache and Path(cache).is_absolute():
        return Path(cache) / "follower"
    try:
        home = Path.home()
    except RuntimeError:
        home = Path("/nonexistent")  # as Debian has it for users without one
    return home / ".cache" / "follower"


class DeviceVerdict:
    """What came of comparing a network on a device with the processor, kept in a file of its own.

    It holds for one network's bytes, version of onnxruntime and device. Only a comparison that was
    made is kept: a device that does not start may do so after its driver is installed. Where the
    file cannot be read or written, networks are compared each time.

    Args:
        network: the bytes of its file.
        device: by its name.
    """

    def __init__(self, network: bytes, device: str) -> None:
        name = f"{hashlib.sha256(network).hexdigest()}-{onnxruntime.__version__}-{device}.txt"
        self._path = cache_folder() / "devices" / name

    def read(self) -> str | None:
        """Return why the device was refused, "" if it was not, None if nobody knows."""
        text = ""
        with suppress(OSError, UnicodeDecodeError):
            text = self._path.read_text("utf-8")
        if text.startswith(_REFUSED):
            return text.removeprefix(_REFUSED)
        return "" if text == _SAME else None

    def write(self, refusal: str) -> None:
        """Keep why the device was refused, "" if it was not."""
        with suppress(OSError):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(self._path, _REFUSED + refusal if refusal else _SAME)
