"""What was identified, and the file in which `follower tune` takes it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field

from follower.identify.recording import VehicleAxis
from follower_control.strict_yaml import SettingsError, parse, read_mapping
from follower_control.tuning.conditions import LoopDelays
from follower_control.tuning.fit import Interval, ResponseFit
from follower_control.tuning.response_data import ResponseData
from follower_control.tuning.response_model import ResponseModel, VehicleModel
from follower_control.tuning.size_relation import SizeFit

_SURE_Z = 1.96


@dataclass(frozen=True, slots=True)
class Spread:
    """A time that varies: its median with its 95 % interval, and what 95 % stay below."""

    median: Interval
    most: float
    samples: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread | None:
        """Return the spread of finite values, None if there are hardly any."""
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
    """All that the recordings told.

    Attributes:
        sources: what was read.
        fits: by axis.
        data: what each was fitted to.
        delays: by their names in `LoopDelays`.
        size: the target's, None if no recording told.
        remarks: what could not be used or told, in sentences.
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
    """What the file says of the target."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    size_m: Annotated[float, Field(gt=0, le=200)] | None = None


class VehicleFile(BaseModel):
    """The file, as `tune` takes it; the evidence is for people, who are told its remarks again."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    vehicle: dict[VehicleAxis, ResponseModel]
    delays: LoopDelays = LoopDelays()
    target: IdentifiedTarget = IdentifiedTarget()
    evidence: dict[str, Any] = {}

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the identification said of itself, in sentences."""
        said = self.evidence.get("remarks")
        return tuple(map(str, said)) if isinstance(said, list) else ()

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
    slope = {} if size.slope is None else {"slope_95": _interval(size.slope)}
    return {
        "size_95": _interval(size.size_m),
        **slope,
        "held_out_spread": _short(size.spread),
        "samples": size.samples,
    }


def _interval(one: Interval) -> list[float]:
    return [_short(one.low), _short(one.high)]


def _short(value: float) -> float:
    return float(f"{value:.4g}")
