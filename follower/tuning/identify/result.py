"""What was identified, and the file in which `follower tune` takes it."""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from html import escape
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml
from matplotlib.figure import Figure
from pydantic import BaseModel, ConfigDict, Field

from follower.report import flight_page, html, style
from follower.report.series import Array, ReportMeta
from follower.report.style import BLUE, INK, PALE, YELLOW
from follower.settings.field_docs import meanings
from follower.tuning.identify.readers import VehicleAxis
from follower_control.common.strict_config import SettingsError, parse, read_mapping
from follower_control.tuning.axis_loop import LoopDelays
from follower_control.tuning.fit import Interval, ResponseFit, SizeFit
from follower_control.tuning.response_model import ResponseData, ResponseModel, VehicleModel
from follower_vision.disk import write_whole

VEHICLE_FILE = "vehicle.yaml"
_SURE_Z = 1.96


@dataclass(frozen=True, slots=True)
class Spread:
    """A time that varies, in seconds: its median with its 95 % interval, and its 95 % quantile."""

    median: Interval
    most: float
    samples: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread | None:
        """Return the spread of finite times, in seconds, None if there are fewer than ten."""
        known = np.sort([value for value in values if math.isfinite(value)])
        count = len(known)
        if count < 10:
            return None
        width = _SURE_Z * math.sqrt(count) / 2
        low, high = math.floor(count / 2 - width), math.ceil(count / 2 + width)
        between = (float(known[max(low, 0)]), float(known[min(high, count - 1)]))
        median = Interval(float(np.median(known)), *between)
        return cls(median, float(np.percentile(known, 95)), count)


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """What the recordings gave.

    Attributes:
        sources: what was read.
        fits: by axis.
        data: what each was fitted to.
        delays: by their names in `LoopDelays`.
        size: the target's, None if no recording gave it.
        remarks: what could not be used or identified, in sentences.
    """

    sources: tuple[str, ...]
    fits: Mapping[VehicleAxis, ResponseFit]
    data: Mapping[VehicleAxis, Sequence[ResponseData]]
    delays: Mapping[str, Spread]
    size: SizeFit | None
    remarks: tuple[str, ...]

    def to_yaml(self) -> str:
        """Return the file's text."""
        plain = {
            "vehicle": {axis.value: _model(fit.model) for axis, fit in self.fits.items()},
            "delays": {name: _short(one.median.value) for name, one in self.delays.items()},
            "target": {} if self.size is None else {"size_m": _short(self.size.size_m.value)},
            "evidence": {
                "sources": list(self.sources),
                **{axis.value: _evidence(fit) for axis, fit in self.fits.items()},
                **{name: _spread(one) for name, one in self.delays.items()},
                **({} if self.size is None else {"size_m": _size(self.size)}),
                "remarks": list(self.remarks),
            },
        }
        return yaml.safe_dump(plain, sort_keys=False, allow_unicode=True)


class IdentifiedTarget(BaseModel):
    """What the file says of the target: its size in metres."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    size_m: Annotated[float, Field(gt=0, le=200)] | None = None


class VehicleFile(BaseModel):
    """The file, as `tune` takes it; the evidence is for users, who get its remarks again."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    vehicle: dict[VehicleAxis, ResponseModel]
    delays: LoopDelays = LoopDelays()
    target: IdentifiedTarget = IdentifiedTarget()
    evidence: dict[str, Any] = {}

    @property
    def remarks(self) -> tuple[str, ...]:
        """The identification's remarks, in sentences."""
        remarks = self.evidence.get("remarks")
        return tuple(map(str, remarks)) if isinstance(remarks, list) else ()

    def model(self) -> VehicleModel:
        """Return all four axes; one horizontal axis stands for the other where that is missing.

        Raises:
            SettingsError: too little is known.
        """
        known = dict(self.vehicle)
        level = known.get(VehicleAxis.FORWARD) or known.get(VehicleAxis.RIGHT)
        down, yaw_rate = known.get(VehicleAxis.DOWN), known.get(VehicleAxis.YAW_RATE)
        if level is None or down is None or yaw_rate is None:
            missing = [axis for axis in VehicleAxis if axis not in known]
            raise SettingsError(
                f"the vehicle's answer is not known for {', '.join(missing)}: identify a flight "
                "of `follower excite`, which moves every axis"
            )
        forward = known.get(VehicleAxis.FORWARD, level)
        return VehicleModel(forward, known.get(VehicleAxis.RIGHT, level), down, yaw_rate)


def load_vehicle(path: Path) -> VehicleFile:
    """Read what `follower identify` wrote.

    Raises:
        SettingsError: it cannot be read, or is not of this form.
    """
    return parse(VehicleFile, read_mapping(path), str(path))


def _model(model: ResponseModel) -> dict[str, float]:
    found = {name: _short(value) for name, value in asdict(model).items() if value is not None}
    return {name: value for name, value in found.items() if name != "lead_s" or value}


def _evidence(fit: ResponseFit) -> dict[str, Any]:
    return {
        "fit": _short(fit.fit),
        "held_out_fit": _short(fit.held_out_fit),
        "held_out_rms": _short(fit.residual_rms),
        "samples": fit.samples,
        "intervals_95": {name: _interval(one) for name, one in fit.intervals.items()},
    }


def _spread(one: Spread) -> dict[str, Any]:
    return {
        "median_95": _interval(one.median),
        "95_percent_below": _short(one.most),
        "samples": one.samples,
    }


def _size(size: SizeFit) -> dict[str, Any]:
    return {
        "size_95": _interval(size.size_m),
        **({} if size.slope is None else {"slope_95": _interval(size.slope)}),
        "held_out_spread": _short(size.spread),
        "samples": size.samples,
    }


def _interval(one: Interval) -> list[float]:
    return [_short(one.low), _short(one.high)]


def _short(value: float) -> float:
    return float(f"{value:.4g}")


UNITS = {axis: "rad/s" if axis.is_turn else "m/s" for axis in VehicleAxis}


def _text(one: Interval, digits: int = 2) -> str:
    """Return a number with its interval."""
    return f"{one.value:.{digits}f} ({one.low:.{digits}f}–{one.high:.{digits}f})"


def model_row(axis: VehicleAxis, fit: ResponseFit) -> tuple[str, ...]:
    """Return one axis' numbers with their intervals, as text."""
    order = f"{fit.model.order}{' with lead' if fit.model.lead_s else ''}"
    names = ("gain", "dead_time_s", "time_constant_s", "damping", "rate_limit")
    numbers = (_text(fit.intervals[name]) if name in fit.intervals else "–" for name in names)
    return (f"{axis} [{UNITS[axis]}]", order, *numbers, f"{100 * fit.held_out_fit:.0f} %")


_GAP_S = 1.5
_LONGEST = 8


def write_identification(path: Path, found: Identification, command: str) -> Path:
    """Write the page and return its path."""
    meta = ReportMeta(
        "How the vehicle answers",
        f"identified from {', '.join(found.sources[:6])}{' …' if len(found.sources) > 6 else ''}",
        command,
        files=((VEHICLE_FILE, "the models, for `follower tune`"),),
    )
    with style.plot_style():
        return write_whole(path, flight_page.filled(meta, _parts(found, meta)))


def axis_figure(axis: VehicleAxis, fit: ResponseFit, data: Sequence[ResponseData]) -> Figure:
    """Draw the recordings of one axis one after the other, the held-out parts tinted."""
    chosen = list(zip(data, fit.offsets, fit.splits_s, strict=True))[:_LONGEST]
    scale = 180 / np.pi if axis.is_turn else 1.0
    length_s = sum(one.length_s + _GAP_S for one, _, _ in chosen)
    figure, (panel,) = style.time_panels([2.6], length_s)
    at_s = 0.0
    for number, (one, offset, split_s) in enumerate(chosen):
        shift = at_s - one.output_s[0]
        labels = ("asked for", "recorded", "model") if number == 0 else ("", "", "")
        end_s = one.output_s[-1]
        panel.axvspan(
            split_s + shift, end_s + shift, color=YELLOW.light, alpha=0.18, lw=0, zorder=0
        )
        times, levels = _held(one)
        style.curve(panel, times + shift, scale * levels, PALE, labels[0])
        style.curve(panel, one.output_s + shift, scale * one.outputs, INK, labels[1], width=0.9)
        model = one.predicted(fit.judged) + offset
        style.curve(panel, one.output_s + shift, scale * model, BLUE, labels[2])
        at_s += one.length_s + _GAP_S
    panel.set_ylabel(f"{axis} [{'deg/s' if axis.is_turn else 'm/s'}]")
    style.legend(panel)
    return figure


def _held(one: ResponseData) -> tuple[Array, Array]:
    """Return the inputs as a staircase between the first and the last sample."""
    times = np.repeat(one.input_s, 2)[1:]
    levels = np.repeat(one.inputs, 2)[:-1]
    inside = (times >= one.output_s[0] - 0.5) & (times <= one.output_s[-1])
    end = np.append(times[inside], one.output_s[-1])
    last = levels[inside][-1] if inside.any() else 0.0
    return end, np.append(levels[inside], last)


def _parts(found: Identification, meta: ReportMeta) -> list[str]:
    rows = [model_row(axis, fit) for axis, fit in found.fits.items()]
    head = ("Axis", "Order", "Gain", "Dead time [s]", "Time constant [s]", "Damping")
    table = html.table((*head, "Rate limit", "Held-out fit"), rows, numbers=(7,))
    note = html.paragraph(
        "In brackets: 95 % intervals. The held-out fit is 100 % for a model that predicts, from "
        "what was asked for alone, all that it was not fitted to, and 0 % for one that is no "
        "better than a constant. Rate limits are in the axis' unit per second: "
        + ", ".join(f"{axis} {unit}" for axis, unit in UNITS.items())
        + "."
    )
    return [
        flight_page.verdict_box("", "Read the plots before you tune by them", found.remarks),
        html.section("Models", table, note),
        *(_axis_section(axis, fit, found.data[axis]) for axis, fit in found.fits.items()),
        html.section("Delays and the target", _times(found)),
        flight_page.about(meta),
    ]


def _axis_section(axis: VehicleAxis, fit: ResponseFit, data: Sequence[ResponseData]) -> str:
    svg = style.to_svg(axis_figure(axis, fit, data), f"axis{axis.replace('_', '')}", escape(axis))
    caption = (
        "Grey: what was sent. Black: what telemetry reported. Blue: what the model predicts from "
        "the grey curve alone. The tinted parts were held out: the blue curve never saw them."
    )
    return html.section(axis.replace("_", " ").capitalize(), html.figure(svg, caption))


def delay_named(name: str) -> str:
    """Return a delay's key in the vehicle's file, and what it is."""
    return f"{name}, {meanings(inspect.getdoc(LoopDelays) or '')[name].removesuffix('.')}"


def _times(found: Identification) -> str:
    rows = [
        (delay_named(name), f"{_text(one.median, 4)} s", f"{one.most:.4f} s", str(one.samples))
        for name, one in found.delays.items()
    ]
    if found.size is not None:
        slope = found.size.slope
        more = "" if slope is None else f", slope {_text(slope)}"
        text = f"{_text(found.size.size_m, 3)} m{more}"
        spread = f"single observations ±{100 * found.size.spread:.0f} %"
        rows.append(("target_size_m", text, spread, str(found.size.samples)))
    return html.table(("What", "Median", "95 % below", "Samples"), rows, numbers=(3,))
