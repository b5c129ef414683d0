"""The report of an evaluation: one HTML file that needs no network."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from string import Template

import cv2
import numpy as np
from matplotlib.figure import Figure

from follower.evaluate.outputs import HEAD, texts
from follower.evaluate.summary import Row, Scored
from follower.report import html, style
from follower_vision import ope
from follower_vision.box import Box
from follower_vision.curves import PRECISION_AT, SUCCESS_AT
from follower_vision.frame import Image

_COLOURS = (style.BLUE, style.ORANGE, style.RED, style.PURPLE, style.SKY, style.YELLOW, style.INK)
_TRUTH = style.GREEN
_WIDE = 320

_PAGE = Template("""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Evaluation of trackers</title><style>
:root { $light } @media (prefers-color-scheme: dark) { :root { $dark } }
body { margin: 0 auto; max-width: 66rem; padding: 1rem; background: var(--paper); color: var(--ink);
 font: 16px/1.5 system-ui, sans-serif; }
table { border-collapse: collapse; } .plot, .table { overflow-x: auto; }
th, td { text-align: left; padding: .2rem 1rem .2rem 0; border-bottom: 1px solid var(--grid); }
.number { text-align: right; } .quiet, figcaption { color: var(--muted); }
.plot svg { width: 100%; height: auto; } img { margin: 0 .4rem .4rem 0; }
</style></head><body><h1>Evaluation of trackers</h1>
$body
</body></html>
""")


def render(
    rows: Sequence[Row],
    runs: Sequence[Scored],
    sequences: Sequence[ope.Sequence],
    remarks: Sequence[str],
) -> str:
    """Return the page."""
    first = [one for one in runs if one.kind == "ope"]
    each = [(one.tracker, one.sequence, *texts(one)) for one in first]
    names = list(dict.fromkeys(one.tracker for one in runs))
    parts = (
        html.section("Means", html.table(HEAD, [(r.tracker, r.kind, *texts(r)) for r in rows])),
        html.section("Curves", _plots([row for row in rows if row.kind == "ope"], names)),
        html.section("Each sequence", html.table(("tracker", "sequence", *HEAD[2:]), each)),
        html.section("Pictures", _key(names), *(_pictures(s, first, names) for s in sequences)),
        html.section("Remarks", *(html.paragraph(remark) for remark in remarks)),
    )
    light, dark = style.css_variables(dark=False), style.css_variables(dark=True)
    return _PAGE.substitute(light=light, dark=dark, body="\n".join(parts))


def _colour(name: str, names: Sequence[str]) -> style.Colour:
    return _COLOURS[names.index(name) % len(_COLOURS)]


def _plots(rows: Sequence[Row], names: Sequence[str]) -> str:
    with style.plot_style():
        figure = Figure(figsize=(style.WIDTH_IN, 3.6), layout="constrained")
        success, precision = figure.subplots(1, 2)
        for row in rows:
            colour = _colour(row.tracker, names).light
            auc, at_20 = row.score.auc, row.score.precision
            label = f"{row.tracker} {auc:.3f}"
            success.plot(SUCCESS_AT, row.curves.success, color=colour, label=label)
            label = f"{row.tracker} {at_20:.3f}"
            precision.plot(PRECISION_AT, row.curves.precision, color=colour, label=label)
        success.set(xlabel="overlap above", ylabel="share of frames", title="Success (AUC)")
        precision.set(xlabel="centre within [px]", title="Precision (at 20 px)")
        for axes in (success, precision):
            axes.set_ylim(0, 1.02)
            axes.legend(loc="best")
        svg = style.to_svg(figure, "ope", "success and precision plots")
    return html.figure(svg, "One-pass evaluation; each sequence has the same weight.")


def _key(names: Sequence[str]) -> str:
    pairs = [("ground truth", _TRUTH), *((name, _colour(name, names)) for name in names)]
    return " ".join(
        f'<span style="color: {colour.light}">&#9632; {html.text_of(name)}</span>'
        for name, colour in pairs
    )


def _pictures(sequence: ope.Sequence, runs: Sequence[Scored], names: Sequence[str]) -> str:
    mine = [one for one in runs if one.sequence == sequence.name]
    last = len(sequence.images) - 1
    shown = "".join(_picture(sequence, mine, names, last * k // 4) for k in (1, 2, 3, 4))
    return f"<h3>{html.text_of(sequence.name)}</h3>{shown}"


def _picture(
    sequence: ope.Sequence, runs: Sequence[Scored], names: Sequence[str], frame: int
) -> str:
    image = ope.read_image(sequence.images[frame])
    factor = _WIDE / image.shape[1]
    small = np.asarray(cv2.resize(image, None, fx=factor, fy=factor), np.uint8)
    _draw(small, sequence.truth[frame], factor, _TRUTH)
    for one in runs:
        _draw(small, one.result.boxes[frame], factor, _colour(one.tracker, names))
    _, coded = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 75])
    data = base64.b64encode(coded.tobytes()).decode("ascii")
    return f'<img alt="frame {frame}" src="data:image/jpeg;base64,{data}">'


def _draw(image: Image, box: Box | None, factor: float, colour: style.Colour) -> None:
    if box is None:
        return
    edges = np.clip([box.left, box.top, box.right, box.bottom], -1e4, 1e4) * factor
    left, top, right, bottom = (int(edge) for edge in edges)
    red, green, blue = bytes.fromhex(colour.light[1:])
    cv2.rectangle(image, (left, top), (right, bottom), (blue, green, red), 1)
