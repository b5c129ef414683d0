"""The report of an evaluation: one HTML file that needs no network."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from follower.apps.evaluate.output_files import (
    DIFFERENCES_HEAD,
    HEAD,
    STATES_HEAD,
    TOOLKITS_HEAD,
    difference_texts,
    interval_text,
    stateless,
    states_texts,
    texts,
    toolkit_texts,
)
from follower.apps.evaluate.scores import (
    COMPARED,
    AttributeRow,
    Difference,
    Evaluation,
    MeanRow,
    ResultRow,
    ScoredRun,
    ToolkitRow,
)
from follower.report import flight_page, html, style, track_losses
from follower.report.html import Cell, Html
from follower.report.series import ReportMeta
from follower.report.style import Colour
from follower_vision.evaluation import one_pass
from follower_vision.evaluation.metrics import NORMALISED_AT, PRECISION_AT, SUCCESS_AT
from follower_vision.geometry.box import Box

TRUTH = style.GREEN
_COLOURS = (style.BLUE, style.RED, style.ORANGE, style.PURPLE, style.SKY, style.INK, style.YELLOW)
_DASHES = ("-", "--", ":", "-.")
_MARKERS = ("o", "s", "^", "D")


@dataclass(frozen=True, slots=True)
class LineStyle:
    """A tracker's number in pictures, and its colour, line and marker in plots."""

    number: int
    colour: Colour
    dash: str
    marker: str


def line_styles(names: Sequence[str]) -> Mapping[str, LineStyle]:
    """Give each name a style of its own; the first ones get solid lines."""
    return {
        name: LineStyle(
            index + 1,
            _COLOURS[index % len(_COLOURS)],
            _DASHES[index // len(_COLOURS) % len(_DASHES)],
            _MARKERS[index // len(_COLOURS) % len(_MARKERS)],
        )
        for index, name in enumerate(names)
    }


def key(styles: Mapping[str, LineStyle], truth: bool = True) -> str:
    """Return the list of trackers with their numbers and colours, and the truth's."""
    items = [_item("truth", TRUTH)] if truth else []
    items += [_item(f"{line.number} {name}", line.colour) for name, line in styles.items()]
    return f'<ul class="key">{"".join(items)}</ul>'


def _item(name: str, colour: Colour) -> str:
    swatch = f'<span class="swatch" style="background: var(--{colour.name})"></span>'
    return f"<li>{swatch}{html.text_of(name)}</li>"


_MOST_ATTRIBUTES = 24
_WIDTH_IN = 4.7
_ATTRIBUTES_IN = 5.6


def curve_plots(rows: Sequence[ResultRow], styles: Mapping[str, LineStyle]) -> str:
    """Return success, precision and normalised precision, a plot each."""
    plots = (
        _plot("success", "Success", "overlap above", SUCCESS_AT, rows, styles,
              [(row.curves.success, row.score.auc) for row in rows]),
        _plot("precision", "Precision", "centre within [px]", PRECISION_AT, rows, styles,
              [(row.curves.precision, row.score.precision) for row in rows]),
        _plot("normalised", "Normalised precision", "centre within [sides of the box]",
              NORMALISED_AT, rows, styles,
              [(row.curves.normalised, row.curves.normalised_precision) for row in rows]),
    )  # fmt: skip
    said = (
        "One-pass evaluation; each sequence has the same weight. Behind each name: the area under "
        "the success curve, the precision at 20 pixels, the mean of the normalised curve."
    )
    return f'<div class="plots">{"".join(plots)}</div>{html.paragraph(said)}'


def _plot(
    name: str,
    title: str,
    xlabel: str,
    thresholds: NDArray[np.float64],
    rows: Sequence[ResultRow],
    styles: Mapping[str, LineStyle],
    curves: Sequence[tuple[Sequence[float], float]],
) -> str:
    """Draw one curve a tracker, the best figure first in the legend below."""
    legend_in = 0.17 * ((len(rows) + 1) // 2)
    with style.plot_style():
        figure = Figure(figsize=(_WIDTH_IN, 3.3 + legend_in), layout="constrained")
        axes = figure.subplots()
        order = sorted(range(len(rows)), key=lambda index: -curves[index][1])
        for index in order:
            line, (shares, value) = styles[rows[index].tracker], curves[index]
            label = style.literal(f"{value:.3f} {rows[index].tracker}")
            colour = line.colour.light
            axes.plot(thresholds, shares, color=colour, linestyle=line.dash, label=label)
        axes.set(xlabel=xlabel, ylabel="share of frames", title=title)
        axes.set_ylim(0, 1.02)
        axes.set_xlim(float(thresholds[0]), float(thresholds[-1]))
        figure.legend(loc="outside lower left", ncols=2, fontsize=7.5, handlelength=2.2)
        svg = style.to_svg(figure, name, f"{title} of {len(rows)} trackers")
    return f'<div class="plot">{svg}</div>'


def attribute_plot(rows: Sequence[AttributeRow], styles: Mapping[str, LineStyle]) -> str:
    """Return each tracker's success by attribute, "" without attributes."""
    counts = Counter({row.attribute: row.sequences for row in rows})
    names = sorted(name for name, _ in counts.most_common(_MOST_ATTRIBUTES))
    if not names:
        return ""
    with style.plot_style():
        figure = Figure(figsize=(_ATTRIBUTES_IN, 0.26 * len(names) + 0.7), layout="constrained")
        axes = figure.subplots()
        for row in reversed(rows):
            if row.attribute in names:
                line = styles[row.tracker]
                place = (row.score.auc, names.index(row.attribute))
                axes.plot(*place, line.marker, color=line.colour.light, markersize=5)
        labels = [style.literal(f"{name} ({counts[name]})") for name in names]
        axes.set_yticks(range(len(names)), labels)
        axes.set_ylim(len(names) - 0.5, -0.5)
        axes.set_xlim(0, 1)
        axes.set(xlabel="area under the success curve")
        svg = style.to_svg(figure, "attributes", "success by attribute")
    said = "Over the frames with each attribute; in brackets the number of sequences that have it."
    return html.figure(svg, said, "wide")


_MOST = 4
_MOST_SEQUENCES = 40
_LASTING = 5
_TOGETHER = 12


def pictures(
    sequences: Sequence[one_pass.Sequence],
    runs: Sequence[ScoredRun],
    styles: Mapping[str, LineStyle],
) -> str:
    """Return up to four pictures of each sequence: where trackers lose their target.

    Of many sequences, only those with the most losses are shown.
    """
    lost = {sequence.name: _failures(sequence, runs) for sequence in sequences}
    worst = sorted(sequences, key=lambda sequence: -len(lost[sequence.name]))[:_MOST_SEQUENCES]
    kept = {sequence.name for sequence in worst}
    shown = (
        _picture(sequence, runs, styles, frame)
        for sequence in sequences
        if sequence.name in kept
        for frame in _grouped(lost[sequence.name]) or [_present(sequence, len(sequence.truth) // 2)]
    )
    return f'<div class="pictures">{"".join(shown)}</div>'


def _failures(sequence: one_pass.Sequence, runs: Sequence[ScoredRun]) -> list[int]:
    """Return the frames in which trackers have lost a sequence's target, in order."""
    boxes = [one.result.boxes for one in runs if one.sequence == sequence.name]
    frames = (_first_failure(answered, sequence.truth) for answered in boxes)
    return sorted(frame for frame in frames if frame is not None)


def _first_failure(boxes: Sequence[Box | None], truth: Sequence[Box | None]) -> int | None:
    """Return the last of the first frames in a row that miss the target, None if there are none."""
    row = 0
    for frame, (box, true) in enumerate(zip(boxes, truth, strict=True)):
        if true is not None:
            row = row + 1 if box is None or box.iou(true) == 0 else 0
        if row == _LASTING:
            return frame
    return None


def _grouped(frames: Sequence[int]) -> list[int]:
    """Return one frame for those close together, of the groups with the most trackers."""
    groups: list[list[int]] = []
    for frame in frames:
        if groups and frame - groups[-1][0] <= _TOGETHER:
            groups[-1].append(frame)
        else:
            groups.append([frame])
    biggest = sorted(groups, key=len, reverse=True)[:_MOST]
    return sorted(group[-1] for group in biggest)


def _present(sequence: one_pass.Sequence, frame: int) -> int:
    """Return the first frame from `frame` on with a target, or the first of all."""
    later = range(frame, len(sequence.truth))
    return next((number for number in later if sequence.truth[number] is not None), 0)


def _picture(
    sequence: one_pass.Sequence,
    runs: Sequence[ScoredRun],
    styles: Mapping[str, LineStyle],
    frame: int,
) -> str:
    true = sequence.truth[frame]
    mine = [one for one in runs if one.sequence == sequence.name]
    boxes = {one.tracker: one.result.boxes[frame] for one in mine}
    missed = [name for name in boxes if _misses(boxes[name], true)]
    shown = {name: box for name, box in boxes.items() if name in missed or not missed}
    image = one_pass.read_image(sequence.images[frame])
    window = track_losses.window_of(image, [true, *shown.values()])
    drawn = track_losses.cut(image, window)
    for name, box in shown.items():
        track_losses.draw(drawn, box, window, styles[name].colour, str(styles[name].number))
    track_losses.draw(drawn, true, window, TRUTH)
    said = "nobody fails" if not missed else f"missed by {', '.join(missed)}"
    return track_losses.figure(drawn, sequence.name, f"frame {frame + 1}: {said}")


def _misses(box: Box | None, true: Box | None) -> bool:
    return true is not None and (box is None or box.iou(true) == 0)


def render(found: Evaluation, sequences: Sequence[one_pass.Sequence]) -> str:
    """Return the page."""
    rows = found.means
    names = list(dict.fromkeys(row.tracker for row in rows))
    once = [one for one in found.runs if one.kind == "ope"]
    styles = line_styles(names)
    table = sequence_table(once, names)
    by_attribute = attribute_plot(found.attributes, styles)
    sections = (
        html.section("Means", means_table(rows)),
        html.section("Differences", difference_plot(found.differences, styles)),
        html.section("Curves", curve_plots([row for row in rows if row.kind == "ope"], styles)),
        html.section("What the states are worth", states_table(rows)),
        html.section(
            "By attribute",
            key(styles, truth=False) if by_attribute else "",
            by_attribute,
        ),
        html.section("By the toolkits' protocols", toolkit_table(found.toolkits)),
        html.section(
            "Success at 0.5 on each sequence", f'<div class="shades">{table}</div>' if once else ""
        ),
        html.section(
            "Failures",
            html.paragraph(
                "The frames in which trackers have missed their target five times in a row; drawn "
                "are those that miss it there, or all where nobody ever does."
            ),
            key(styles),
            pictures(sequences, once, styles) if once else "",
        ),
        html.section("Remarks", *(html.paragraph(remark) for remark in found.remarks)),
    )
    rules = resources.files("follower.apps.evaluate").joinpath("report.css").read_text("utf-8")
    frames = sum(len(sequence.images) for sequence in sequences)
    subtitle = f"{len(names)} trackers on {len(sequences)} sequences of {frames} frames"
    return flight_page.filled(ReportMeta("Evaluation of trackers", subtitle), sections, rules)


def means_table(rows: Sequence[MeanRow]) -> str:
    """Return the means, with their intervals where there are some."""
    shown: list[list[Cell]] = []
    for row in rows:
        cells: list[Cell] = [row.tracker, row.kind, *texts(row)]
        for column, figure in enumerate(COMPARED, 2):
            if figure in row.intervals:
                bounds = interval_text(*row.intervals[figure])
                value = html.text_of(cells[column])
                cells[column] = Html(f'{value}<br><small class="quiet">{bounds}</small>')
        shown.append(cells)
    said = "In brackets: 95 % bootstrap intervals of the mean, the sequences drawn anew."
    remark = html.paragraph(said) if any(row.intervals for row in rows) else ""
    return html.table(HEAD, shown, range(2, len(HEAD))) + remark


def difference_plot(found: Sequence[Difference], styles: Mapping[str, LineStyle]) -> str:
    """Return each tracker's difference from the first one, drawn and as a table; "" without."""
    if not found:
        return ""
    drawn = [one for one in found if one.figure == COMPARED[0]]
    labels = [one.tracker if one.kind == "ope" else f"{one.tracker} ({one.kind})" for one in drawn]
    with style.plot_style():
        figure = Figure(figsize=(_ATTRIBUTES_IN, 0.26 * len(drawn) + 0.8), layout="constrained")
        axes = figure.subplots()
        for place, one in enumerate(drawn):
            line, paired = styles[one.tracker], one.paired
            axes.plot([paired.low, paired.high], [place, place], color=line.colour.light)
            axes.plot(paired.mean, place, line.marker, color=line.colour.light, markersize=5)
        axes.axvline(0, color=style.INK.light, linewidth=0.8)
        axes.set_yticks(range(len(drawn)), [style.literal(one) for one in labels])
        axes.set_ylim(len(drawn) - 0.5, -0.5)
        reference = style.literal(drawn[0].reference)
        axes.set(xlabel=f"AUC minus that of {reference}, with 95 % intervals")
        svg = style.to_svg(figure, "differences", "differences of AUC")
    said = (
        f"Against {drawn[0].reference}, the first that was named, on the sequences that both ran. "
        "p: how often differences as large come of flipping the sequences' signs at random, as "
        "between equal trackers; it is not corrected for the number of comparisons."
    )
    rows = [difference_texts(one) for one in found]
    return html.figure(svg, said, "wide") + html.table(
        DIFFERENCES_HEAD, rows, range(4, len(DIFFERENCES_HEAD))
    )


def toolkit_table(rows: Sequence[ToolkitRow]) -> str:
    """Return the figures that stand beside published ones."""
    said = (
        "One-pass figures as got10k-toolkit and vot-toolkit compute them from the files in got10k/ "
        "and vot/. OTB scores the first frame; GOT-10k pools all frames and cuts boxes at the "
        "image's edge; VOT (average accuracy, unsupervised) counts whole pixels from the eleventh "
        "frame on and weighs sequences by their length. – where regions are no boxes."
    )
    table = html.table(
        TOOLKITS_HEAD, [toolkit_texts(row) for row in rows], range(1, len(TOOLKITS_HEAD))
    )
    return table + html.paragraph(said) if rows else ""


def states_table(rows: Sequence[ResultRow]) -> str:
    """Return what the states are worth, and who has none."""
    stated = [(row.tracker, row.kind, *states_texts(row.states)) for row in rows if row.states]
    silent, head = stateless(rows), (*HEAD[:2], *STATES_HEAD)
    remark = (
        "TRACKING at IoU 0: share of the frames with the target in which the tracker said TRACKING "
        "beside it. Doubted: share of the right boxes (overlap above 0.5) not called TRACKING. "
        "Returns: the target came back after an absence; losses: the tracker lost it while it was "
        "there; median: seconds until a right box was called TRACKING; under 0.5 s: share so soon."
    )
    parts = [html.table(head, stated, range(2, len(head))), html.paragraph(remark)]
    unknown = html.paragraph(f"No states are known of {', '.join(silent)}.") if silent else ""
    return "\n".join([*(parts if stated else ()), unknown])


def sequence_table(runs: Sequence[ScoredRun], trackers: Sequence[str]) -> str:
    """Return success@0.5 of each tracker on each sequence, shaded."""
    values = {(one.sequence, one.tracker): one.score.success for one in runs}
    names = dict.fromkeys(one.sequence for one in runs)
    rows: list[list[Cell]] = [
        [name, *(_shaded(values.get((name, one))) for one in trackers)] for name in names
    ]
    upright = [f'<span class="upright">{html.text_of(one)}</span>' for one in trackers]
    head: list[Cell] = ["", *(Html(text) for text in upright)]
    return html.table(head, rows, range(1, len(head)))


def _shaded(share: float | None) -> Html:
    if share is None:
        return Html("–")
    percent = round(45 * share)
    shade = f"color-mix(in srgb, var(--green) {percent}%, transparent)"
    return Html(f'<span class="shaded" style="background: {shade}">{share:.2f}</span>')
