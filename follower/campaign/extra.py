"""Packages that only campaigns need."""

from __future__ import annotations

import importlib
from typing import Any

from follower_control.strict_yaml import SettingsError


def needed(module: str) -> Any:
    """Import a package of the extra `campaign`.

    Raises:
        SettingsError: it is not installed; the message says how to get it.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise SettingsError(
            f"{error.name} is not installed; in the clone: pip install -e '.[campaign]'"
        ) from None
