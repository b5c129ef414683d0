"""What really happened in a simulated flight."""

from collections.abc import Callable, Sequence

from follower.flight.log import ControlRecord, FlightLog, TrackRecord, setpoint_delays
from follower.flight.supervision.flight_end import HANDED_OVER, LastRelease
from follower.flight.supervision.supervisor import SupervisorReason
from follower_sim.kinematics import BodyState, TruthSample
from follower_sim.scoring.ground_truth import GroundTruth
from follower_sim.scoring.identity_score import IdentityScore, TrackedFrame, identity_score
from follower_sim.scoring.score import PursuitGoal, PursuitScore, PursuitStep, pursuit_score
from follower_sim.world.silhouettes import SeenBody
from follower_sim.world.world import World
from follower_vision.geometry.box import Box
from follower_vision.geometry.line_of_sight import LineOfSight
from follower_vision.trackers.track import TrackState

BodyAt = Callable[[float], BodyState]


class FlightTruth:
    """Takes the truth beside each control step, and holds tracks against it.

    Args:
        world: what there is.
        vehicle_at: gives the vehicle's body at a time.
        camera_at: gives the body that carries the camera.

    Attributes:
        samples: the truth, a sample a control step.
        tracked: what came of each frame in which the target was reported as tracked.
    """

    def __init__(self, world: World, vehicle_at: BodyAt, camera_at: BodyAt) -> None:
        self.samples: list[TruthSample] = []
        self._cameras: dict[float, BodyState] = {}
        self.tracked: list[TrackedFrame] = []
        self._world = world
        self._vehicle_at = vehicle_at
        self._camera_at = camera_at
        self._ground_truth = GroundTruth(world)
        self._newest: tuple[float, SeenBody] | None = None

    def take(self, now_s: float) -> TruthSample:
        """Take and return the truth at `now_s`, seconds on the flight's clock."""
        body, camera = self._vehicle_at(now_s), self._camera_at(now_s)
        sample = self._ground_truth.sample(now_s, body, camera=camera)
        self.samples.append(sample)
        self._cameras[now_s] = camera
        return sample

    def box_direction(self, sample: TruthSample) -> LineOfSight:
        """Work out the direction of the true box's middle for one of the samples."""
        return self._ground_truth.box_sight(sample, self._cameras[sample.time_s])

    def compare(self, record: TrackRecord) -> None:
        """Compare a track that claims to see the target with the truth, for the score."""
        track = record.track
        if track is None or track.state is not TrackState.TRACKING:
            return
        box, true_s = self.of_frame(record.captured_s).box, self._true_time(record.captured_s)
        overlap = 0.0 if box is None else box.iou(track.box)
        others: list[Box] = []
        if len(self._world.paths) > 1:
            bodies = self._vehicle_at(true_s), self._camera_at(true_s)
            others = self._ground_truth.others(true_s, *bodies)
        nearest = max((other.iou(track.box) for other in others), default=0.0)
        self.tracked.append(TrackedFrame(true_s, overlap, nearest))

    def of_frame(self, stamp_s: float) -> SeenBody:
        """Return where the target truly is in a frame with this capture stamp."""
        if self._newest is not None and self._newest[0] == stamp_s:
            return self._newest[1]
        true_s = self._true_time(stamp_s)
        seen = self._ground_truth.seen(true_s, self._camera_at(true_s))
        self._newest = stamp_s, seen
        return seen

    @property
    def identity(self) -> IdentityScore:
        """What has become of the target's identity."""
        return identity_score(self.samples, self.tracked, len(self._world.paths) > 1)

    def _true_time(self, stamp_s: float) -> float:
        return stamp_s - self._world.scenario.camera.stamp_offset_s


def score_flight(
    log: FlightLog,
    truth: Sequence[TruthSample],
    goal: PursuitGoal,
    *,
    overlaps: Sequence[float] = (),
    identity: IdentityScore | None = None,
    chosen_s: float | None = None,
    box_sight: Callable[[TruthSample], LineOfSight] | None = None,
) -> PursuitScore:
    """Score a flight up to the stop or to the handing over, or to its end if there was neither.

    Args:
        log: the flight.
        truth: samples on the log's clock, in the order of time.
        goal: what was wanted.
        identity: what became of the target's identity, if it is known.
        overlaps: intersection over union with the true box, one for each tracked frame.
        chosen_s: when the operator asked for the target, if it is known.
        box_sight: works out the direction of the true box's middle, if there are boxes.
    """
    return pursuit_score(
        truth,
        [
            PursuitStep(
                r.time_s, str(r.state), r.allowed if r.sent else None, tuple(map(str, r.limits))
            )
            for r in log.controls
        ],
        goal,
        delays_s=list(setpoint_delays(log.controls).values()),
        overlaps=overlaps,
        identity=identity,
        chosen_s=chosen_s,
        end_s=stopped_s(log.controls),
        box_sight=box_sight,
    )


def stopped_s(controls: Sequence[ControlRecord]) -> float | None:
    """Return when the operator's stop took effect, or the pilot took over for good."""
    stops = [r.time_s for r in controls if r.reason is SupervisorReason.STOP_REQUESTED][:1]
    return min(stops + _handed_over_s(controls), default=None)


def _handed_over_s(controls: Sequence[ControlRecord]) -> list[float]:
    release = LastRelease.of((r.state, r.reason) for r in controls)
    flown_s = [r.time_s for r in controls if r.state.engaged]
    if not flown_s or release.end.exit_code != HANDED_OVER:
        return []
    return [next(r.time_s for r in controls if r.time_s > flown_s[-1])]
