"""How plots look: one palette, one grid, light and dark from the same drawing.

Plots are drawn in the light colours. As SVG inside the page, each of those colours is replaced by
a CSS variable, which the page sets for light, dark and print. The palette follows Okabe and Ito
(Color Universal Design, 2008), whose colours stay apart for colour-blind readers.
"""

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from follower.report.series import Array, Span, thinned


@dataclass(frozen=True, slots=True)
class Colour:
    """One colour of the palette: its CSS variable, and what it is on light and dark paper."""

    name: str
    light: str
    dark: str


INK = Colour("ink", "#1b1f24", "#e8ebf0")
MUTED = Colour("muted", "#667080", "#98a2b0")
GRID = Colour("grid", "#e1e5ea", "#2d333c")
PAPER = Colour("paper", "#fefefe", "#14181d")
BLUE = Colour("blue", "#0072b2", "#4fa9e4")
ORANGE = Colour("orange", "#e69f00", "#efb33a")
GREEN = Colour("green", "#009e73", "#2fc49a")
RED = Colour("red", "#d55e00", "#ff8b4d")
SKY = Colour("sky", "#56b4e9", "#3f86b0")
YELLOW = Colour("yellow", "#e8d21d", "#d8c532")
PURPLE = Colour("purple", "#a8578c", "#d58bbd")
PALE = Colour("pale", "#c3cad3", "#4c5563")

PALETTE = (INK, MUTED, GRID, PAPER, BLUE, ORANGE, GREEN, RED, SKY, YELLOW, PURPLE, PALE)

STATES = {
    "idle": PALE,
    "tracking": SKY,
    "ready": BLUE,
    "following": GREEN,
    "coasting": YELLOW,
    "searching": ORANGE,
    "holding": RED,
    "released": PURPLE,
}
"""The supervisor's states from the first to the last."""

TRACK_STATES = {"none": PALE, "tracking": GREEN, "coasting": YELLOW, "lost": RED}

UNSEEN = {name: TRACK_STATES[name] for name in ("coasting", "lost")}
"""Of vision's states, those in which the target was not seen."""

WIDTH_IN = 9.0
_LEFT, _RIGHT = 0.085, 0.985
_PARAMETERS: Any = {
    "svg.fonttype": "none",
    "font.size": 9,
    "font.sans-serif": ["DejaVu Sans"],
    "axes.edgecolor": MUTED.light,
    "axes.labelcolor": INK.light,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.titlecolor": INK.light,
    "grid.color": GRID.light,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED.light,
    "ytick.color": MUTED.light,
    "xtick.labelcolor": INK.light,
    "ytick.labelcolor": INK.light,
    "text.color": INK.light,
    "lines.linewidth": 1.3,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
}


@contextmanager
def plot_style() -> Iterator[None]:
    """Draw in this module's style inside the `with`, and leave matplotlib as it was."""
    with mpl.rc_context(_PARAMETERS):
        yield


def time_panels(
    heights_in: Sequence[float], until_s: float, top_in: float = 0.3
) -> tuple[Figure, list[Axes]]:
    """Return a figure of panels below each other with one time axis, 0 to `until_s` seconds."""
    gaps_in = 0.32 * (len(heights_in) - 1)
    bottom_in = 0.48
    tall = sum(heights_in) + gaps_in + top_in + bottom_in
    figure = Figure(figsize=(WIDTH_IN, tall))
    grid = figure.add_gridspec(len(heights_in), 1, height_ratios=list(heights_in))
    grid.update(
        left=_LEFT,
        right=_RIGHT,
        top=1 - top_in / tall,
        bottom=bottom_in / tall,
        hspace=0.32 * len(heights_in) / sum(heights_in),
    )
    axes: list[Axes] = []
    for row in range(len(heights_in)):
        axes.append(figure.add_subplot(grid[row], sharex=axes[0] if axes else None))
        axes[-1].tick_params(labelbottom=row == len(heights_in) - 1)
    axes[-1].set_xlabel("time [s]")
    figure.align_ylabels(axes)
    axes[0].set_xlim(0, max(until_s, 1e-3))
    return figure, axes


def literal(name: str) -> str:
    """Return a name, which anyone may have chosen, as text in which `$` begins no formula."""
    return name.replace("$", r"\$")


def curve(
    axes: Axes, time: Array, values: Array, colour: Colour, label: str = "", *, width: float = 1.3
) -> None:
    """Draw one curve; nothing, not even a legend's entry, if no value is known."""
    x, y = thinned(time, values)
    if (y == y).any():
        axes.plot(x, y, color=colour.light, linewidth=width, label=label or None)


def level(axes: Axes, value: float, label: str = "") -> None:
    """Draw a dashed horizontal line: a wanted value or a limit."""
    axes.axhline(value, color=MUTED.light, linewidth=1, linestyle=(0, (5, 3)), label=label or None)


def legend(axes: Axes, handles: Sequence[Artist] | None = None) -> None:
    """Put the legend above the panel, on the left, where a narrow screen shows it first.

    Args:
        axes: the panel.
        handles: what it lists, by default everything with a label.
    """
    handles = axes.get_legend_handles_labels()[0] if handles is None else handles
    if handles:
        axes.legend(
            handles=handles,
            loc="lower left",
            bbox_to_anchor=(0.0, 0.99),
            ncols=len(handles),
            borderaxespad=0.2,
            columnspacing=1.4,
            handlelength=1.6,
        )


def shade(axes: Axes, spans: Sequence[Span], colours: dict[str, Colour]) -> None:
    """Tint the background where a span's state is one of `colours`."""
    for span in spans:
        if span.state in colours:
            axes.axvspan(
                span.start_s,
                span.end_s,
                facecolor=colours[span.state].light,
                alpha=0.18,
                linewidth=0,
                zorder=0,
            )


def save_png(figure: Figure, path: Path) -> None:
    """Write a figure on light paper."""
    figure.savefig(path, format="png", dpi=110, facecolor=PAPER.light)


def to_svg(figure: Figure, name: str, description: str) -> str:
    """Return a figure as an <svg> element that takes its colours from the page.

    Args:
        figure: drawn within `plot_style`.
        name: unique on the page; makes the element's ids unique.
        description: read aloud in the picture's place.
    """
    buffer = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", svg)
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(\bid="|href="#|url\(#)', rf"\1{name}-", svg)
    for colour in PALETTE:
        svg = svg.replace(colour.light, f"var(--{colour.name})")
    return svg.replace("<svg", f'<svg role="img" aria-label="{description}"', 1)


def css_variables(dark: bool) -> str:
    """Return the palette as CSS declarations."""
    return " ".join(
        f"--{colour.name}: {colour.dark if dark else colour.light};" for colour in PALETTE
    )
