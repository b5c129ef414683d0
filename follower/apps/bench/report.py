"""A bench's tables and pictures, of one board and of several side by side."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.markup import escape
from rich.table import Table

from follower.apps.bench.result import BenchResult, BenchRow
from follower.report import style

_SERIES = (style.BLUE, style.ORANGE, style.GREEN, style.PURPLE, style.RED, style.SKY, style.INK)
_MARKERS = "os^Dvpx"
_UNKNOWN = "–"
_ROW_IN, _PANEL_IN, _EDGE_IN = 0.24, 3.9, 1.5

Texts = tuple[str, ...]


def board_rows(result: BenchResult) -> tuple[Texts, list[Texts]]:
    """Return a table's head and rows: what sees, its rate at each size, and what it costs.

    The rate has a * where the target was lost. The other figures are the worst over the sizes: how
    late control steps begin (p99), and processor time.
    """
    sizes = result.sizes
    rows: list[Texts] = []
    for name, by_size in _grouped(result.rows).items():
        worst = by_size.values()
        rows.append(
            (
                name,
                *(_rate(by_size.get(size)) for size in sizes),
                f"{max(row.late_p99_ms for row in worst):.1f}",
                f"{max(row.cores for row in worst):.1f}",
            )
        )
    return ("frames/s", *sizes, "late ms", "cores"), rows


def compared_rows(results: Sequence[BenchResult]) -> tuple[Texts, list[Texts]]:
    """Return a table's head and rows: the rate of each set-up on each board."""
    names = [_grouped(result.rows) for result in results]
    every = dict.fromkeys(
        (name, size)
        for result, rows in zip(results, names, strict=True)
        for name in rows
        for size in result.sizes
    )
    rows = [
        (name, size, *(_rate(board.get(name, {}).get(size)) for board in names))
        for name, size in every
        if any(size in board.get(name, {}) for board in names)
    ]
    return ("frames/s", "size", *(result.name for result in results)), rows


def terminal_table(head: Texts, rows: Iterable[Texts], left: int = 1) -> Table:
    """Return the same for the terminal; the first `left` columns are words."""
    table = Table(show_edge=False, pad_edge=False)
    for number, heading in enumerate(head):
        table.add_column(escape(heading), justify="left" if number < left else "right")
    for row in rows:
        table.add_row(*map(escape, row))
    return table


@dataclass(frozen=True, slots=True)
class _Panel:
    """One plot: a figure of each name, in series."""

    title: str
    label: str
    series: Mapping[str, Mapping[str, float]]
    limits: tuple[float, ...] = ()


def draw_board(result: BenchResult, wanted_hz: float, path: Path) -> Path:
    """Draw the rates and the control's punctuality of one board as PNG.

    Args:
        result: the figures.
        wanted_hz: the camera's rate with the margin.
        path: the file.
    """
    groups = _grouped(result.rows)
    rates = {
        size: {name: rows[size].rate_hz for name, rows in groups.items() if size in rows}
        for size in result.sizes
    }
    late = {
        size: {name: rows[size].late_p99_ms for name, rows in groups.items() if size in rows}
        for size in result.sizes
    }
    limits = (result.rate_hz, wanted_hz)
    panels = (
        _Panel("Vision", "frames/s", rates, limits),
        _Panel("Control at 50 Hz", "begins late, p99 [ms]", late),
    )
    return _draw(result.name, list(groups), panels, path)


def draw_compared(results: Sequence[BenchResult], path: Path) -> Path:
    """Draw the rates of several boards as PNG, a panel a size."""
    boards = {result.name: _grouped(result.rows) for result in results}
    names = list(dict.fromkeys(name for groups in boards.values() for name in groups))
    sizes = dict.fromkeys(size for result in results for size in result.sizes)
    panels = [
        _Panel(
            size,
            "frames/s",
            {
                board: {n: rows[size].rate_hz for n, rows in groups.items() if size in rows}
                for board, groups in boards.items()
            },
        )
        for size in sizes
    ]
    return _draw("Rates of vision", names, panels, path)


def _draw(title: str, names: Sequence[str], panels: Sequence[_Panel], path: Path) -> Path:
    width, height = _PANEL_IN * len(panels) + _EDGE_IN, _ROW_IN * len(names) + _EDGE_IN
    with style.plot_style():
        figure = Figure(figsize=(width, height), layout="constrained")
        figure.suptitle(title, x=0.01, ha="left", fontsize=10)
        several = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
        for axes, panel in zip(several, panels, strict=True):
            _plot(axes, panel, names)
        handles, labels = several[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower left", ncols=len(labels))
        style.save_png(figure, path)
    return path


def _plot(axes: Axes, panel: _Panel, names: Sequence[str]) -> None:
    for number, (label, figures) in enumerate(panel.series.items()):
        axes.plot(
            list(figures.values()),
            [names.index(name) for name in figures],
            _MARKERS[number % len(_MARKERS)],
            color=_SERIES[number % len(_SERIES)].light,
            markersize=5,
            label=label,
        )
    for limit in panel.limits:
        axes.axvline(limit, color=style.MUTED.light, linewidth=1, linestyle=(0, (5, 3)))
    axes.set_yticks(range(len(names)), [style.literal(name) for name in names])
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlim(left=0)
    axes.set(title=panel.title, xlabel=panel.label)


def _grouped(rows: Iterable[BenchRow]) -> dict[str, dict[str, BenchRow]]:
    """Return the rows by what sees, video and camera, and then by size."""
    groups: dict[str, dict[str, BenchRow]] = {}
    for row in rows:
        camera = "" if row.camera_hz is None else f", camera {row.camera_hz:g}/s"
        name = f"{row.name}{'' if row.video else ', no video'}{camera}"
        groups.setdefault(name, {})[row.size] = row
    return groups


def _rate(row: BenchRow | None) -> str:
    if row is None:
        return _UNKNOWN
    return f"{row.rate_hz:.0f}{' *' if row.lost else ''}"
