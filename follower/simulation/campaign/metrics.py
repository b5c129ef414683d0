"""The figures of one run: what a campaign keeps of a flight."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from follower.flight.log import ControlRecord
from follower.flight.supervision.supervisor import SupervisorState
from follower.simulation.flight import SimulatedFlight
from follower.simulation.ground_truth import stopped_s
from follower_control.envelope.fence import Fence
from follower_control.envelope.settings import EnvelopeSettings
from follower_sim.kinematics import TruthSample
from follower_sim.scoring.identity_score import wrong_end
from follower_sim.scoring.occlusions import HIDDEN, ObservedFrame, Occlusion, occlusions
from follower_sim.scoring.score import IN_FRAME, PursuitScore
from follower_vision.trackers.track import TrackState

_SLACK = 1.01
_SLACK_M = 0.5


@dataclass(frozen=True, slots=True)
class RunMetrics:
    """What came of one flight; None stands for what could not be measured.

    Times from the approach's end to the operator's stop are "scored".

    Attributes:
        time_to_acquire_s: from the choice of the target to following it.
        approach_s: from then to the approach's end.
        scored_s: length of the scored time.
        in_frame_share: share of it with half the target in the image, occlusions left out.
        in_frame_share_all: the same with them.
        line_of_sight_rms_deg: root mean square of the line-of-sight error over the scored time.
        line_of_sight_box_rms_seen_deg: the same, occlusions left out, of the true box's middle
            instead of the body's: a tracker can show no other, and the servo holds it.
        range_error_median: median of |range / wanted - 1|.
        range_error_p95: its 95th percentile.
        occlusion_s: length of each occlusion.
        reacquired_s: from the end of each until the target was rightly seen again; None: never.
        wrong_end: how it ended without its target, by the name of a `WrongEnd`; None: with it.
        losses: how often the supervisor began to search.
        wrong_box_share: share of the frames with a track whose box misses the target.
        delay_median_s: from a frame's capture to its setpoint.
        envelope_violations: how many of the envelope's limits were broken.
        nearest_m: least true distance to the target while the follower steered.
        keep_out_m: the envelope's least distance; None if it has none.
        acceleration_rms_m_s2: of the horizontal setpoints.
        yaw_acceleration_rms_deg_s2: of the yaw rate's setpoints.
    """

    time_to_acquire_s: float | None
    approach_s: float | None
    scored_s: float
    in_frame_share: float | None
    in_frame_share_all: float | None
    line_of_sight_rms_deg: float | None
    line_of_sight_box_rms_seen_deg: float | None
    range_error_median: float | None
    range_error_p95: float | None
    occlusion_s: tuple[float, ...]
    reacquired_s: tuple[float | None, ...]
    wrong_end: str | None
    losses: int
    wrong_box_share: float | None
    delay_median_s: float | None
    envelope_violations: int
    nearest_m: float | None
    keep_out_m: float | None
    acceleration_rms_m_s2: float | None
    yaw_acceleration_rms_deg_s2: float | None

    @property
    def is_too_near(self) -> bool:
        """Whether the vehicle came into the target's keep-out."""
        both = self.nearest_m is not None and self.keep_out_m is not None
        return both and self.nearest_m < self.keep_out_m  # type: ignore[operator]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values that JSON can hold."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self).items()}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> RunMetrics:
        """Return what `to_dict` was made from; other keys are left alone."""
        kept = {name: data[name] for name in cls.__dataclass_fields__}
        for name in ("occlusion_s", "reacquired_s"):
            kept[name] = tuple(kept[name])
        return cls(**kept)


def figures_of(flight: SimulatedFlight) -> RunMetrics:
    """Return the figures of a flight that is over."""
    score = flight.score()
    end_s = stopped_s(flight.log.controls) or math.inf
    scored = _scored(flight.truth, score, end_s)
    hidden = _occlusions(flight, scored, end_s)
    seen = [sample for sample in scored if sample.visible_share >= HIDDEN]
    limits = flight.settings.envelope
    steering = [record for record in flight.log.controls if record.state.steers and record.sent]
    violations = _broken_setpoints(score, steering, limits) + _broken_places(flight, limits)
    accelerations = _accelerations(steering)
    return RunMetrics(
        score.time_to_acquire_s,
        score.approach_s,
        score.scored_s,
        sum(one.in_frame_share >= IN_FRAME for one in seen) / len(seen) if seen else None,
        score.in_frame_share,
        score.line_of_sight_rms_deg,
        score.line_of_sight_box_rms_seen_deg,
        score.range_error_median,
        score.range_error_p95,
        tuple(round(one.length_s, 6) for one in hidden),
        tuple(None if t is None else round(t, 6) for t in (one.reacquired_s for one in hidden)),
        wrong_end(flight.truth, flight.ground_truth.tracked, end_s),
        score.losses,
        score.wrong_box_share,
        score.delay_median_s,
        violations,
        _nearest_m(flight, end_s),
        limits.min_distance_m,
        _rms(np.linalg.norm(accelerations[:, :2], axis=1)),
        _rms(np.degrees(accelerations[:, 3])),
    )


def _scored(
    truth: Sequence[TruthSample], score: PursuitScore, end_s: float
) -> Sequence[TruthSample]:
    """Return the samples of the scored time, which is the last part before the stop."""
    if score.approach_s is None:
        return ()
    flown = [sample for sample in truth if sample.time_s <= end_s]
    from_s = flown[-1].time_s - score.scored_s - 1e-6
    return [sample for sample in flown if sample.time_s >= from_s]


def _occlusions(
    flight: SimulatedFlight, scored: Sequence[TruthSample], end_s: float
) -> list[Occlusion]:
    if not scored:
        return []
    tracked = [
        record
        for record in flight.log.tracks
        if record.track is not None and record.track.state is TrackState.TRACKING
    ]
    seen_frames = [
        ObservedFrame(frame.time_s, record.done_s)
        for record, frame in zip(tracked, flight.ground_truth.tracked, strict=True)
        if frame.overlap > 0
    ]
    return occlusions(flight.truth, seen_frames, scored[0].time_s, min(end_s, scored[-1].time_s))


def _broken_setpoints(
    score: PursuitScore, steering: Sequence[ControlRecord], limits: EnvelopeSettings
) -> int:
    """Return how many of the limits on setpoints were broken."""
    values = np.array([record.allowed.values for record in steering]).reshape(-1, 4)
    forward, right, down, yaw_rate = values.T
    yaw_limit, peaks = math.radians(limits.max_yaw_rate_deg_s), score.commanded
    pairs = (
        (_peak(np.hypot(forward, right)), limits.max_speed_m_s),
        (_peak(-down), limits.max_climb_m_s),
        (_peak(down), limits.max_descent_m_s),
        (_peak(np.abs(yaw_rate)), yaw_limit),
        (peaks.horizontal_acceleration_m_s2, limits.max_acceleration_m_s2),
        (peaks.vertical_acceleration_m_s2, limits.max_acceleration_m_s2),
        (peaks.yaw_acceleration_deg_s2, limits.max_yaw_acceleration_deg_s2),
        (peaks.horizontal_jerk_m_s3, limits.max_jerk_m_s3),
        (peaks.vertical_jerk_m_s3, limits.max_jerk_m_s3),
        (peaks.yaw_jerk_deg_s3, limits.max_yaw_jerk_deg_s3),
    )
    return sum(limit is not None and value > _SLACK * limit for value, limit in pairs)


def _broken_places(flight: SimulatedFlight, limits: EnvelopeSettings) -> int:
    """Return how many of the limits on places the true vehicle broke while it was steered."""
    steered = {record.time_s for record in flight.log.controls if record.state.steers}
    places = [s.vehicle.position_m for s in flight.truth if s.time_s in steered]
    if not places:
        return 0
    north, east, down = np.array(places).T
    home = flight.scenario.start.at
    flown = [complex(*place) for place in zip(north - home[0], east - home[1], strict=True)]
    polygon = None if limits.fence_m is None else Fence(limits.fence_m)
    pairs = (
        (max(map(abs, flown)), limits.fence_radius_m),
        (max(map(polygon.outside_m, flown)) if polygon else 0.0, 0.0),
        (float(-down.min()), limits.ceiling_m),
        (float(down.max()), None if limits.min_height_m is None else -limits.min_height_m),
    )
    return sum(limit is not None and value > limit + _SLACK_M for value, limit in pairs)


def _nearest_m(flight: SimulatedFlight, end_s: float) -> float | None:
    first = next(
        (r.time_s for r in flight.log.controls if r.state is SupervisorState.FOLLOWING), math.inf
    )
    ranges = [s.range_m for s in flight.truth if first <= s.time_s <= end_s]
    return min(ranges, default=None)


def _accelerations(steering: Sequence[ControlRecord]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the changes of the setpoints with time, (N, 4); pauses are left out."""
    values = np.array([record.allowed.values for record in steering]).reshape(-1, 4)
    steps = np.diff(np.array([record.time_s for record in steering]))
    good = (steps > 0) & (steps < 0.1)
    return np.asarray(np.diff(values, axis=0)[good] / steps[good, None])


def _peak(values: np.ndarray[Any, np.dtype[np.float64]]) -> float:
    return float(values.max(initial=0.0))


def _rms(values: np.ndarray[Any, np.dtype[np.float64]]) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None
