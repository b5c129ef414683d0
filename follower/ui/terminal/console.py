"""Prints lines as they are: paths and commands in them stay whole and can be copied."""

import contextlib
import importlib
import os
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TextIO, cast

from rich.console import Console

from follower_control.common.strict_config import SettingsError


def print_line(console: Console, text: str, style: str | None = None) -> None:
    """Print a line. It is not wrapped, and brackets in it are brackets, not styles."""
    console.print(text, style=style, markup=False, highlight=False, soft_wrap=True)


def quiet_console() -> Console:
    """Return a console that prints nothing and leaves the terminal to others."""
    return Console(quiet=True, force_terminal=False)


class _LastingOutput:
    """Standard output that takes what is written also when nobody reads it any more."""

    def __getattr__(self, name: str) -> Any:
        return getattr(sys.stdout, name)

    def write(self, text: str) -> int:
        """Write, or throw away."""
        with self._unbroken():
            sys.stdout.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush, or throw away."""
        with self._unbroken():
            sys.stdout.flush()

    @contextlib.contextmanager
    def _unbroken(self) -> Iterator[None]:
        try:
            yield
        except OSError:  # a pipe or a terminal that is gone; Python flushes it once more at its end
            with Path(os.devnull).open("wb") as nothing:
                os.dup2(nothing.fileno(), sys.stdout.fileno())


def lasting_console() -> Console:
    """Return a console for what must not end because nobody reads its output any more: a flight."""
    return Console(file=cast(TextIO, _LastingOutput()))


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


def check_extra(what: str, extra: str, *modules: str) -> None:
    """Make sure that the packages of an extra are installed.

    Args:
        what: needs them.
        extra: its name.
        modules: of it.

    Raises:
        SettingsError: one is missing; the message says how to get it.
    """
    missing = [name for name in modules if find_spec(name) is None]
    if missing:
        raise SettingsError(
            f"{what} needs {', '.join(missing)}; in the clone: pip install -e '.[{extra}]'"
        )


def counted(number: int, thing: str) -> str:
    """Return a number of things: "1 frame", "2 frames"."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"
