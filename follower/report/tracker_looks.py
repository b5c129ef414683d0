"""How each tracker of an evaluation is drawn, everywhere on the page alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from follower.report import html, style
from follower.report.style import Colour

TRUTH = style.GREEN
_COLOURS = (style.BLUE, style.RED, style.ORANGE, style.PURPLE, style.SKY, style.INK, style.YELLOW)
_DASHES = ("-", "--", ":", "-.")
_MARKERS = ("o", "s", "^", "D")


@dataclass(frozen=True, slots=True)
class Look:
    """A tracker's number in pictures, and its colour, line and marker in plots."""

    number: int
    colour: Colour
    dash: str
    marker: str


def looks(names: Sequence[str]) -> Mapping[str, Look]:
    """Give each name a look of its own; the first ones get solid lines."""
    return {
        name: Look(
            index + 1,
            _COLOURS[index % len(_COLOURS)],
            _DASHES[index // len(_COLOURS) % len(_DASHES)],
            _MARKERS[index // len(_COLOURS) % len(_MARKERS)],
        )
        for index, name in enumerate(names)
    }


def key(found: Mapping[str, Look], truth: bool = True) -> str:
    """Return the list of trackers with their numbers and colours, and the truth's."""
    items = [_item("truth", TRUTH)] if truth else []
    items += [_item(f"{look.number} {name}", look.colour) for name, look in found.items()]
    return f'<ul class="key">{"".join(items)}</ul>'


def _item(name: str, colour: Colour) -> str:
    swatch = f'<span class="swatch" style="background: var(--{colour.name})"></span>'
    return f"<li>{swatch}{html.text_of(name)}</li>"
