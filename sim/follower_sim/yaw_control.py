"""The body's yaw axis: rate loop, torque and heading."""

from __future__ import annotations

import math

from follower_sim.response import YawResponse


class YawAxis:
    """Follows a rate about the body's down axis with the lags of a real one.

    Attributes:
        rate_rad_s: the present body rate.
    """

    def __init__(self, response: YawResponse) -> None:
        self._response = response
        self._max = math.radians(response.max_acceleration_deg_s2)
        self.reset()

    def reset(self) -> None:
        """Stand still."""
        self.rate_rad_s = 0.0
        self._torque = 0.0
        self._integral = 0.0
        self._behind = 0.0

    def update(self, demand_rad_s: float, heading_rate_rad_s: float, dt: float) -> float:
        """Return the new body rate.

        Args:
            demand_rad_s: the rate asked for.
            heading_rate_rad_s: what the heading really does; while tilted that is not the body's.
            dt: seconds.
        """
        y = self._response
        self._behind += (demand_rad_s - heading_rate_rad_s) * dt
        error = demand_rad_s + y.heading_per_s * self._behind - self.rate_rad_s
        asked = y.p_per_s * error + self._integral
        limited = max(-self._max, min(self._max, asked))
        if asked == limited:
            self._integral += y.i_per_s2 * error * dt
        self._torque += (limited - self._torque) * min(1.0, dt / y.lag_s)
        self.rate_rad_s += (self._torque - y.drag_per_s * self.rate_rad_s) * dt
        return self.rate_rad_s
