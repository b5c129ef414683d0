"""Parts that other installed packages add, found by their entry points.

A package is asked for a part only when the part's name is: lists of names import nothing of it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Container, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, TypeVar

AnswerT = TypeVar("AnswerT")
SURE = 1.01
"""No confidence is above it: 1, with room for rounding."""

_LOGGER = logging.getLogger(__name__)
_OURS = "drone-target-follower"
_TOLD: list[Callable[[str], None]] = []


class PluginError(ValueError):
    """A plug-in cannot be used; the message is one line that names its package."""


@dataclass(frozen=True, slots=True)
class Plugin:
    """A part that a package adds, not imported yet.

    Attributes:
        noun: what it is to be, e.g. "tracker".
        entry: its name, its package and where it is in it.
        needs: attributes that it must have once it is made.
    """

    noun: str
    entry: EntryPoint
    needs: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.noun} {self.entry.name!r} of {_package(self.entry)}"

    def load(self) -> Callable[..., Any]:
        """Import what makes the part.

        Raises:
            PluginError: it cannot be imported, or cannot be called.
        """
        try:
            factory = self.entry.load()
        except Exception as error:  # whatever a package of others does when it is imported
            raise PluginError(f"the {self} cannot be imported: {said(error)}") from error
        if not callable(factory):
            raise PluginError(f"the {self} is none: {self.entry.value} cannot be called")
        return factory  # type: ignore[no-any-return]

    def make(self, *arguments: object) -> Any:
        """Import and make the part.

        Raises:
            PluginError: it cannot be imported or made, or is of another kind.
        """
        factory = self.load()
        try:
            made = factory(*arguments)
            missing = [name for name in self.needs if not hasattr(made, name)]
        except Exception as error:  # as above
            raise PluginError(f"the {self} cannot be made: {said(error)}") from error
        if missing:
            raise PluginError(f"the {self} is none: it has no {', no '.join(missing)}")
        return made


@dataclass(frozen=True, slots=True)
class PluginGroup:
    """One kind of parts that packages may add.

    Attributes:
        name: of the entry points' group, e.g. "follower.trackers".
        noun: what one is called in messages.
        needs: attributes that each must have once it is made.
    """

    name: str
    noun: str
    needs: tuple[str, ...] = ()

    def names(self, built_in: Container[str] = ()) -> list[str]:
        """Return the names that packages add, in order.

        A name that two packages add, or that is built in, is left out with one warning.
        """
        kept = []
        for name, entries in sorted(self._entries().items()):
            if name in built_in:
                warn_once(self._clash(name, [_OURS, *map(_package, entries)]))
            elif len(entries) > 1:
                warn_once(self._clash(name, [*map(_package, entries)]))
            else:
                kept.append(name)
        return kept

    def find(self, name: str) -> Plugin | None:
        """Return what a package adds under a name that is not built in, None if none does.

        Raises:
            PluginError: two packages do.
        """
        entries = self._entries().get(name, [])
        if len(entries) > 1:
            raise PluginError(self._clash(name, [*map(_package, entries)]))
        return Plugin(self.noun, entries[0], self.needs) if entries else None

    def _entries(self) -> dict[str, list[EntryPoint]]:
        found: dict[str, list[EntryPoint]] = {}
        for entry in entry_points(group=self.name):
            found.setdefault(entry.name, []).append(entry)
        return found

    def _clash(self, name: str, packages: list[str]) -> str:
        taken, what = ("the first", "the other") if _OURS in packages else ("neither", "one")
        both = " and ".join(packages)
        return f"{both} each have a {self.noun} {name!r}: {taken} is taken; uninstall {what}"


class PluginGuard:
    """Calls a plug-in's part in flight: what it does wrong is named once and ends nothing.

    Args:
        plugin: the part, for the warning.
        instead: what it means for the flight, for the same.
    """

    def __init__(self, plugin: Plugin, instead: str = "counts as seeing nothing") -> None:
        self._plugin = plugin
        self._instead = instead
        self._told = False

    def run(
        self, call: Callable[[], AnswerT], otherwise: AnswerT, is_sound: Callable[[AnswerT], bool]
    ) -> AnswerT:
        """Return the part's answer, or `otherwise` if it raises or answers what is not sound."""
        try:
            answer = call()
            if is_sound(answer):
                return answer
            fault = "its answer is none, not finite, or surer than 1"
        except Exception as error:  # whatever the code of others does must not end a flight
            fault = said(error)
        if not self._told:
            self._told = True
            text = f"the {self._plugin} fails, and {self._instead}: {fault}"
            _LOGGER.warning("%s", text)
            for tell in tuple(_TOLD):
                tell(text)
        return otherwise


@contextmanager
def telling_failures(tell: Callable[[str], None]) -> Iterator[None]:
    """Have what parts of other packages do wrong in flight told to `tell` too, while entered.

    It is called on the thread on which the part fails.
    """
    _TOLD.append(tell)
    try:
        yield
    finally:
        _TOLD.remove(tell)


@cache
def warn_once(text: str) -> None:
    """Log a warning, unless it was logged before."""
    _LOGGER.warning("%s", text)


def _package(entry: EntryPoint) -> str:
    return entry.value if entry.dist is None else f"{entry.dist.name} {entry.dist.version}"


def said(error: Exception) -> str:
    """Return an error's kind and text in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}".removesuffix(": ")
