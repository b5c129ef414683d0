"""How a vehicle answers a velocity or yaw rate that is asked for: a few numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from follower_control.tuning.rational import Rational


@dataclass(frozen=True, slots=True)
class ResponseModel:
    """Order one: K / (T s + 1). Order two: K (b s + 1) / (T² s² + 2 ζ T s + 1). Both with a delay.

    Attributes:
        gain: steady output per input.
        dead_time_s: from the sending of a setpoint until the vehicle begins to answer.
        time_constant_s: T; of order two, one over the natural frequency.
        damping: ζ; None makes the order one.
        lead_s: b; a slow last part of the answer shows as a lead that the slow pole does not
            cancel.
        rate_limit: the output changes no faster than this, per second; None if that was not seen.
            Left out of the linear model.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    gain: float
    dead_time_s: float
    time_constant_s: float
    damping: float | None = None
    lead_s: float = 0.0
    rate_limit: float | None = None

    def __post_init__(self) -> None:
        if not 0 < self.gain < math.inf:
            raise ValueError(f"gain is finite and above 0, not {self.gain}")
        if not 0 <= self.dead_time_s < math.inf:
            raise ValueError(f"dead_time_s is finite and not negative, not {self.dead_time_s}")
        if not 0 < self.time_constant_s < math.inf:
            raise ValueError(f"time_constant_s is finite and above 0, not {self.time_constant_s}")
        if self.damping is not None and not 0 < self.damping < math.inf:
            raise ValueError(f"damping is finite and above 0, not {self.damping}")
        if not 0 <= self.lead_s < math.inf:
            raise ValueError(f"lead_s is finite and not negative, not {self.lead_s}")
        if self.rate_limit is not None and not self.rate_limit > 0:
            raise ValueError(f"rate_limit is above 0, not {self.rate_limit}")

    @property
    def order(self) -> int:
        """One or two."""
        return 1 if self.damping is None else 2

    @property
    def denominator(self) -> tuple[float, ...]:
        """Coefficients, the highest power of s first."""
        t = self.time_constant_s
        return (t, 1.0) if self.damping is None else (t * t, 2 * self.damping * t, 1.0)

    @property
    def linear(self) -> Rational:
        """The model without its rate limit."""
        numerator = (self.gain * self.lead_s, self.gain) if self.lead_s else (self.gain,)
        return Rational(numerator, self.denominator, self.dead_time_s)


@dataclass(frozen=True, slots=True)
class VehicleModel:
    """How a vehicle answers on each axis; velocities in its heading frame, SI units and radians.

    Attributes:
        forward, right, down: velocities.
        yaw_rate: the turning of the nose.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    forward: ResponseModel
    right: ResponseModel
    down: ResponseModel
    yaw_rate: ResponseModel
