"""The loops of one set of settings, now, tuned, and under other circumstances."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from follower.identify.result import VehicleFile
from follower.settings import Settings
from follower.tune.what_if import WhatIf
from follower_control.pid import PidSettings
from follower_control.tuning.axes import Axis, Follower, axis_loop
from follower_control.tuning.axis_loop import AxisLoop
from follower_control.tuning.conditions import Conditions
from follower_control.tuning.response_model import VehicleModel
from follower_control.tuning.synthesis import Tuned, Wish, tune


@dataclass(frozen=True, slots=True)
class AxisAnalysis:
    """One axis.

    Attributes:
        axis: which.
        gains: the present ones.
        now: the loop with them.
        tuned: what was found, None if nothing was looked for.
        what_ifs: the loop that counts (tuned, else now) under each other circumstance.
        max_sensitivity: what Ms is wanted to stay below.
    """

    axis: Axis
    gains: PidSettings
    now: AxisLoop
    tuned: Tuned | None
    what_ifs: tuple[tuple[str, AxisLoop], ...] = ()
    max_sensitivity: float = Wish().max_sensitivity

    @property
    def chosen(self) -> PidSettings:
        """The gains that count."""
        return self.gains if self.tuned is None else self.tuned.gains


def follower_of(settings: Settings) -> Follower:
    """Return what of the settings the loops depend on."""
    return Follower(settings.servo, settings.estimator, settings.envelope)


def conditions_of(settings: Settings, vehicle: VehicleFile, elevation_deg: float) -> Conditions:
    """Return steady following at the wanted distance, with the identified delays."""
    servo = settings.servo
    size_m = vehicle.target.size_m or servo.target_size_m or Conditions().size_m
    delays = replace(vehicle.delays, control_interval_s=1 / settings.control_rate_hz)
    return Conditions(delays, servo.distance_m, math.radians(elevation_deg), size_m)


def analyse(
    settings: Settings,
    vehicle: VehicleModel,
    conditions: Conditions,
    wishes: Mapping[Axis, Wish] | None,
    what_ifs: Sequence[WhatIf] = (),
    each: Callable[[Sequence[Axis]], Sequence[Axis]] = list,
) -> list[AxisAnalysis]:
    """Look at every axis; with wishes, find gains for it."""
    follower = follower_of(settings)
    found = []
    for axis in each(list(Axis)):
        gains = follower.gains(axis)
        now = axis_loop(axis, gains, vehicle, follower, conditions)
        tuned = None
        if wishes is not None:
            tuned = tune(axis, vehicle, follower, conditions, wishes[axis])
        chosen = gains if tuned is None else tuned.gains
        others = tuple(
            (
                one.words,
                axis_loop(axis, _scaled(chosen, one.gain), vehicle, follower, one.conditions),
            )
            for one in what_ifs
        )
        wish = Wish() if wishes is None else wishes[axis]
        found.append(AxisAnalysis(axis, gains, now, tuned, others, wish.max_sensitivity))
    return found


def overlay(analysis: Sequence[AxisAnalysis]) -> dict[str, Any]:
    """Return the gains in the form in which settings are read."""
    return {"servo": {one.axis.value: _plain(one.chosen) for one in analysis}}


def _plain(gains: PidSettings) -> dict[str, float]:
    names = PidSettings.__slots__
    return {name: float(f"{getattr(gains, name):.4g}") for name in names}


def _scaled(gains: PidSettings, factor: float) -> PidSettings:
    return replace(gains, kp=factor * gains.kp, ki=factor * gains.ki, kd=factor * gains.kd)
