"""The truth at one instant, for score, report and the log of a simulated flight."""

from __future__ import annotations

from dataclasses import dataclass

from follower_sim.kinematics import BodyState, Triple


@dataclass(frozen=True, slots=True)
class TruthSample:
    """The truth at one instant, taken beside every control step.

    Attributes:
        time_s: on the system's clock.
        vehicle: where the vehicle really is and how it moves.
        target_position_m: (north, east, down) of the target's centre.
        target_velocity_m_s: (north, east, down).
        in_frame_share: share of the target's true box that lies inside the image, 0 to 1.
        visible_share: share of the target that nothing hides, 0 to 1.
        range_m: distance from the camera to the target's centre.
        azimuth_rad: of the target from the vehicle's heading, positive to the right.
        elevation_rad: of the target from the horizontal, positive up.
    """

    time_s: float
    vehicle: BodyState
    target_position_m: Triple
    target_velocity_m_s: Triple
    in_frame_share: float
    visible_share: float
    range_m: float
    azimuth_rad: float
    elevation_rad: float
