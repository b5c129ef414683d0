"""The pursuit score, computed from the simulator's truth."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from follower_control.vehicle.setpoint import VelocitySetpoint
from follower_sim.kinematics import TruthSample
from follower_sim.scoring.identity_score import IdentityScore
from follower_sim.scoring.occlusions import HIDDEN
from follower_vision.geometry.line_of_sight import LineOfSight

_ENGAGED = frozenset({"following", "coasting", "searching", "holding"})

STEERING = frozenset({"following", "coasting"})
"""Names of the supervisor's states in which the servo steers."""
IN_FRAME = 0.5
"""The target is in frame if at least this share of its true box is inside the image."""
APPROACH_RANGE = 0.15
"""The approach is over within this share of the wanted distance, ..."""
APPROACH_ANGLE_RAD = math.radians(5)
"""... with less than this line-of-sight error, ..."""
APPROACH_HELD_S = 1.0
"""... both for this long."""
_BOX_EVERY_S = 0.1
"""A box takes longer to work out than the vehicle to fly on; its direction changes slowly."""


@dataclass(frozen=True, slots=True)
class PursuitStep:
    """One step of the control loop, as far as the score needs it.

    Attributes:
        time_s: when the step ran, on the system's clock.
        state: the supervisor's state by its name: "idle", "tracking", "ready", "following",
            "coasting", "searching", "holding" or "released".
        setpoint: what was sent to the autopilot, None if nothing was.
        limits: names of the envelope's limits that changed it.
    """

    time_s: float
    state: str
    setpoint: VelocitySetpoint | None
    limits: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class CommandedPeaks:
    """The largest change of what was commanded, all in the heading frame; 0 if nothing was.

    Acceleration is the difference of two setpoints sent one after the other over the time between
    them; jerk is the difference of two such accelerations over the later one's time, which is how
    the envelope counts it. Horizontal is the length of the vector (forward, right); the turning of
    the heading itself is not counted. Setpoints with unsent steps between them are not compared,
    nor is the last hold before following with the first setpoint of it, which begins at the
    vehicle's own velocity.
    """

    horizontal_acceleration_m_s2: float
    vertical_acceleration_m_s2: float
    yaw_acceleration_deg_s2: float
    horizontal_jerk_m_s3: float
    vertical_jerk_m_s3: float
    yaw_jerk_deg_s3: float


def commanded_peaks(steps: Sequence[PursuitStep]) -> CommandedPeaks:
    """Return the largest accelerations and jerks of the setpoints sent, in the order of time."""
    peaks = np.zeros((2, 3))
    for run in _unbroken(steps):
        peaks = np.maximum(peaks, _run_peaks(run))
    (acceleration, vertical, yaw), (jerk, vertical_jerk, yaw_jerk) = peaks.tolist()
    return CommandedPeaks(
        acceleration, vertical, math.degrees(yaw), jerk, vertical_jerk, math.degrees(yaw_jerk)
    )


def _unbroken(steps: Sequence[PursuitStep]) -> Iterable[_Array]:
    """Yield runs of steps that were all sent: rows of (time, forward, right, down, yaw rate)."""
    run: list[tuple[float, ...]] = []
    engaged = False
    for step in steps:
        engages = step.state in _ENGAGED and not engaged
        engaged = step.state in _ENGAGED
        if step.setpoint is None or engages:
            yield np.array(run)
            run = []
        if step.setpoint is not None and (not run or step.time_s > run[-1][0]):
            run.append((step.time_s, *step.setpoint.values))
    yield np.array(run)


def _run_peaks(run: _Array) -> _Array:
    """Return the peaks of one run: rows acceleration, jerk; columns horizontal, vertical, yaw."""
    if len(run) < 2:
        return np.zeros((2, 3))
    interval = np.diff(run[:, 0])[:, None]
    acceleration = np.diff(run[:, 1:], axis=0) / interval
    jerk = np.diff(acceleration, axis=0) / interval[1:]
    return np.array([_largest(acceleration), _largest(jerk)])


def _largest(change: _Array) -> _Array:
    """Return the largest horizontal, vertical and yaw component, shape (3,), of (N, 4)."""
    if not len(change):
        return np.zeros(3)
    horizontal = np.hypot(change[:, 0], change[:, 1])
    return np.array(
        [horizontal.max(), np.abs(change[:, 2]).max(), np.abs(change[:, 3]).max()], np.float64
    )


_Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PursuitGoal:
    """What the pursuit was to reach: the target straight ahead, so high, so far away.

    Attributes:
        distance_m: wanted distance; None if the pursuit was only to watch: range is not scored.
        elevation_rad: wanted elevation of the target from the horizontal, up is positive; None for
            a vehicle that only turns and cannot mend it: azimuth alone is scored.
    """

    distance_m: float | None
    elevation_rad: float | None = 0.0

    def __post_init__(self) -> None:
        if self.distance_m is not None and not 0 < self.distance_m < math.inf:
            raise ValueError(f"a wanted distance is positive, not {self.distance_m}")
        if self.elevation_rad is not None and not math.isfinite(self.elevation_rad):
            raise ValueError(f"a wanted elevation is finite, not {self.elevation_rad}")


@dataclass(frozen=True, slots=True)
class Intervention:
    """How often one limit of the envelope changed the setpoint.

    Attributes:
        steps: number of sent control steps that it changed.
        share: that number over the number of all sent steps.
    """

    steps: int
    share: float


@dataclass(frozen=True, slots=True)
class PursuitScore:
    """How well a pursuit went.

    "Scored" is the time from the approach's end to the end of the pursuit, losses included. Shares,
    means and percentiles over it are weighted with the time between samples. None stands for what
    could not be measured, because the target was never acquired or never approached, or because
    nothing of the kind was given.

    Attributes:
        time_to_acquire_s: from the choice of the target to the first step in state "following".
        approach_s: from that step to the approach's end, which is the first time from which on,
            for 1 s, the range is within 15 % of the wanted one and the line-of-sight error below
            5 degrees.
        scored_s: length of the scored time, 0 if there is none.
        in_frame_share: share of the scored time with at least half of the true box in the image.
        line_of_sight_rms_deg: root mean square over the scored time of the angle between the true
            direction of the target and the wanted one.
        line_of_sight_p95_deg: 95th percentile of that angle.
        line_of_sight_box_rms_seen_deg: root mean square, occlusions left out, of the same angle to
            the true box's middle instead of the body's: a tracker can show no other, and the servo
            holds it.
        range_error_median: median of |range / wanted - 1|.
        range_error_p95: its 95th percentile.
        following_share: share of the control steps from the first "following" to the pursuit's
            end in which the servo steered.
        losses: how often the state went from "following" or "coasting" to "searching".
        reacquisitions: how often it then came back to "following".
        wrong_box_share: share of the frames said to be tracked whose box does not touch the true
            one, over the whole flight.
        delay_median_s: from a frame's capture to the setpoint that first used it, median.
        delay_p99_s: the same, 99th percentile.
        limited_share: share of the sent steps that the envelope changed.
        interventions: the same by the limit's name.
        commanded: peaks of the commanded acceleration and jerk.
        identity: how soon the target was found again, and whether another was taken for it.
    """

    time_to_acquire_s: float | None
    approach_s: float | None
    scored_s: float
    in_frame_share: float | None
    line_of_sight_rms_deg: float | None
    line_of_sight_p95_deg: float | None
    line_of_sight_box_rms_seen_deg: float | None
    range_error_median: float | None
    range_error_p95: float | None
    following_share: float | None
    losses: int
    reacquisitions: int
    wrong_box_share: float | None
    delay_median_s: float | None
    delay_p99_s: float | None
    limited_share: float
    interventions: Mapping[str, Intervention]
    commanded: CommandedPeaks
    identity: IdentityScore = field(default_factory=IdentityScore)

    def to_dict(self) -> dict[str, Any]:
        """Return plain dicts and numbers that JSON can hold."""
        return asdict(self)


def pursuit_score(
    truth: Sequence[TruthSample],
    steps: Sequence[PursuitStep],
    goal: PursuitGoal,
    *,
    delays_s: Sequence[float] = (),
    overlaps: Sequence[float] = (),
    identity: IdentityScore | None = None,
    chosen_s: float | None = None,
    end_s: float | None = None,
    box_sight: Callable[[TruthSample], LineOfSight] | None = None,
) -> PursuitScore:
    """Score one pursuit.

    Args:
        truth: samples in the order of time.
        steps: control steps in the order of time, on the same clock.
        goal: what was wanted.
        delays_s: capture to setpoint, one a frame that was used.
        overlaps: intersection over union of the track's box and the true one, one for each frame
            that vision said to track.
        identity: what became of the target's identity, if it is known.
        chosen_s: when the operator asked for the target; by default the first step that is not
            "idle".
        end_s: when the operator ended the pursuit; what comes later is not scored. By default it
            lasts to the last sample.
        box_sight: works out the direction of the true box's middle, if there are boxes.
    """
    steps = [step for step in steps if end_s is None or step.time_s <= end_s]
    truth = [sample for sample in truth if end_s is None or sample.time_s <= end_s]
    course = _Course.of(truth, goal)
    acquired_s = next((step.time_s for step in steps if step.state == "following"), None)
    if chosen_s is None:
        chosen_s = next((step.time_s for step in steps if step.state != "idle"), None)
    approached_s = None if acquired_s is None else course.approached(acquired_s)
    losses, reacquisitions = _losses(steps)
    box_rms_deg = None
    if box_sight is not None and approached_s is not None:
        box_rms_deg = _box_rms_seen_deg(truth, approached_s, goal, box_sight)
    return PursuitScore(
        time_to_acquire_s=_between(chosen_s, acquired_s),
        approach_s=_between(acquired_s, approached_s),
        **course.after(approached_s).figures(),
        line_of_sight_box_rms_seen_deg=box_rms_deg,
        following_share=_following_share(steps),
        losses=losses,
        reacquisitions=reacquisitions,
        wrong_box_share=_share([overlap <= 0 for overlap in overlaps]),
        delay_median_s=_percentile(delays_s, 50),
        delay_p99_s=_percentile(delays_s, 99),
        limited_share=_share([bool(s.limits) for s in steps if s.setpoint is not None]) or 0.0,
        interventions=_interventions(steps),
        commanded=commanded_peaks(steps),
        identity=identity or IdentityScore(),
    )


def line_of_sight_errors(truth: Sequence[TruthSample], goal: PursuitGoal) -> _Array:
    """Return the angle between the target's true and wanted direction, radians, shape (N,)."""
    azimuth = np.array([sample.azimuth_rad for sample in truth], np.float64)
    if goal.elevation_rad is None:
        return np.abs(azimuth)
    elevation = np.array([sample.elevation_rad for sample in truth], np.float64)
    # The haversine keeps its precision where the arc cosine of a dot product loses it: at 0.
    haversine = (
        np.sin((elevation - goal.elevation_rad) / 2) ** 2
        + np.cos(elevation) * math.cos(goal.elevation_rad) * np.sin(azimuth / 2) ** 2
    )
    return np.asarray(2 * np.arcsin(np.sqrt(np.clip(haversine, 0.0, 1.0))))


def _box_rms_seen_deg(
    truth: Sequence[TruthSample],
    from_s: float,
    goal: PursuitGoal,
    box_sight: Callable[[TruthSample], LineOfSight],
) -> float | None:
    """Return the root mean square of the error of the box's direction while it can be seen."""
    seen = list[TruthSample]()
    next_s = from_s
    for sample in truth:
        if sample.time_s < next_s or sample.visible_share < HIDDEN:
            continue
        next_s = sample.time_s + _BOX_EVERY_S
        sight = box_sight(sample)
        seen.append(
            replace(sample, azimuth_rad=sight.azimuth_rad, elevation_rad=sight.elevation_rad)
        )
    if not seen:
        return None
    # Each stands for as long: by its neighbours' times, one would for the occlusion beside it.
    return math.degrees(math.sqrt(float(np.mean(line_of_sight_errors(seen, goal) ** 2))))


@dataclass(frozen=True, slots=True)
class _Course:
    """The truth as arrays, shape (N,) each; `range_error` is None if no range was wanted."""

    time_s: _Array
    in_frame: _Array
    angle: _Array
    range_error: _Array | None

    @classmethod
    def of(cls, truth: Sequence[TruthSample], goal: PursuitGoal) -> _Course:
        ranges = np.array([sample.range_m for sample in truth], np.float64)
        return cls(
            np.array([sample.time_s for sample in truth], np.float64),
            np.array([sample.in_frame_share >= IN_FRAME for sample in truth], np.float64),
            line_of_sight_errors(truth, goal),
            None if goal.distance_m is None else np.abs(ranges / goal.distance_m - 1),
        )

    def approached(self, from_s: float) -> float | None:
        """Return when the approach was over, None if it never was."""
        good = self.angle < APPROACH_ANGLE_RAD
        if self.range_error is not None:
            good &= self.range_error <= APPROACH_RANGE
        since: float | None = None
        for time_s, is_good in zip(self.time_s.tolist(), good.tolist(), strict=True):
            if not is_good or time_s < from_s:
                since = None
                continue
            since = time_s if since is None else since
            # A sampled second is over at its last sample: allow for rounding of the times.
            if time_s - since >= APPROACH_HELD_S - 1e-6:
                return since
        return None

    def after(self, from_s: float | None) -> _Course:
        """Return the part from a time on; nothing if it is None."""
        late = self.time_s >= (math.inf if from_s is None else from_s)
        range_error = None if self.range_error is None else self.range_error[late]
        return _Course(self.time_s[late], self.in_frame[late], self.angle[late], range_error)

    def figures(self) -> dict[str, Any]:
        """Return the score's figures that are taken over this time."""
        angle_deg = np.degrees(self.angle)
        mean_square = self._mean(angle_deg**2)
        return {
            "scored_s": float(self.time_s[-1] - self.time_s[0]) if len(self.time_s) else 0.0,
            "in_frame_share": self._mean(self.in_frame),
            "line_of_sight_rms_deg": None if mean_square is None else math.sqrt(mean_square),
            "line_of_sight_p95_deg": self._quantile(angle_deg, 0.95),
            "range_error_median": self._quantile(self.range_error, 0.5),
            "range_error_p95": self._quantile(self.range_error, 0.95),
        }

    def _weights(self) -> _Array:
        """Return the time that each sample stands for; equal weights if time stands still."""
        if len(self.time_s) < 2 or self.time_s[-1] <= self.time_s[0]:
            return np.ones(len(self.time_s))
        return np.asarray(np.gradient(self.time_s))

    def _mean(self, values: _Array) -> float | None:
        return float(np.average(values, weights=self._weights())) if len(values) else None

    def _quantile(self, values: _Array | None, share: float) -> float | None:
        if values is None or not len(values):
            return None
        weights = self._weights()
        return float(np.quantile(values, share, weights=weights, method="inverted_cdf"))


def _between(start_s: float | None, end_s: float | None) -> float | None:
    return None if start_s is None or end_s is None else end_s - start_s


def _share(flags: Sequence[bool]) -> float | None:
    return sum(flags) / len(flags) if flags else None


def _percentile(values: Sequence[float], percent: float) -> float | None:
    return float(np.percentile(np.asarray(values, np.float64), percent)) if len(values) else None


def _following_share(steps: Sequence[PursuitStep]) -> float | None:
    steering = [step.state in STEERING for step in steps]
    return _share(steering[steering.index(True) :]) if True in steering else None


def _losses(steps: Sequence[PursuitStep]) -> tuple[int, int]:
    """Return how often the target was lost and how often found again."""
    losses = reacquisitions = 0
    before, lost = "", False
    for step in steps:
        if step.state == "searching" and before in STEERING:
            losses, lost = losses + 1, True
        elif step.state == "following" and lost:
            reacquisitions, lost = reacquisitions + 1, False
        before = step.state
    return losses, reacquisitions


def _interventions(steps: Sequence[PursuitStep]) -> dict[str, Intervention]:
    sent = [step for step in steps if step.setpoint is not None]
    counts = Counter(name for step in sent for name in step.limits)
    return {name: Intervention(n, n / len(sent)) for name, n in counts.most_common()}
