"""What a recording guarantees about its replay, and what the terminal says of one."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import Console
from rich.table import Table

from follower.print_line import print_line
from follower.recorder import RecordedFlight, VideoKind
from follower.recorder.config import running_versions
from follower.replay.comparison import Comparison, Difference

_GROWTH_S = (1.0, 5.0)


def pictures_are_exact(flight: RecordedFlight) -> bool:
    """Tell whether the video holds what vision saw, bit for bit.

    It does if it is lossless; and if the flight is itself a saved replay, whose tracks were made
    from these decoded pictures.
    """
    if "tracks_from" in flight.config.run:
        return True
    return bool(flight.config.group("recorder").get("video") == VideoKind.LOSSLESS)


def changed_versions(flight: RecordedFlight) -> list[str]:
    """Return in words which versions are others today."""
    now = running_versions()
    recorded = flight.config.versions
    names = [name for name in now if name in recorded and recorded[name] != now[name]]
    return [f"{name} {now[name]}, recorded with {recorded[name]}" for name in names]


def print_comparison(console: Console, title: str, parts: tuple[Difference, ...]) -> None:
    """Print a table of what differs, or a line that nothing does."""
    compared = max((len(one.times_s) for one in parts), default=0)
    differing = [one for one in parts if one.count]
    if not differing:
        print_line(console, f"{title}: {compared} compared, identical")
        return
    print_line(console, f"{title}: {compared} compared, these differ:")
    table = Table()
    table.add_column("what", no_wrap=True)
    for heading in ("differ", "first at", *(f"after {s:g} s" for s in _GROWTH_S), "largest"):
        table.add_column(heading, justify="right")
    for one in differing:
        table.add_row(*_row(one))
    console.print(table)


def first_difference(comparison: Comparison) -> str:
    """Return one line about where it begins, "" if it does not."""
    first_s = comparison.first_s
    if first_s is None:
        return ""
    names = [one.name for one in comparison.differing if one.first_s == first_s]
    return f"The first difference is at {first_s:.3f} s: {', '.join(names)}."


def _row(one: Difference) -> Iterator[str]:
    yield one.name
    yield str(one.count)
    first_s = one.first_s or 0.0
    yield f"{first_s:.3f} s"
    for after_s in _GROWTH_S:
        yield _amount(one, one.largest_until(first_s + after_s))
    yield _amount(one, one.largest)


def _amount(one: Difference, value: float) -> str:
    return f"{value:.2g} {one.unit}".strip() if one.is_number else "–"
