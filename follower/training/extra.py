"""Says what to install where the extra `train` is missing."""

from __future__ import annotations

from importlib.util import find_spec

from follower_control.strict_yaml import SettingsError

_NEEDED = ("torch", "onnx")


def check_extra() -> None:
    """Make sure that training can run here.

    Raises:
        SettingsError: torch or onnx is missing.
    """
    missing = [name for name in _NEEDED if find_spec(name) is None]
    if missing:
        raise SettingsError(
            f"training needs {' and '.join(missing)}; in the clone: pip install -e '.[train]'"
        )
