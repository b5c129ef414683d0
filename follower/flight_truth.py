"""What really happened in a simulated flight."""

from __future__ import annotations

from collections.abc import Callable

from follower.flightlog import TrackRecord
from follower_sim.identity_score import IdentityScore, TrackedFrame, identity_score
from follower_sim.kinematics import BodyState
from follower_sim.silhouettes import SeenBody
from follower_sim.truth import TruthTeller
from follower_sim.truth_sample import TruthSample
from follower_sim.world import World
from follower_vision.box import Box
from follower_vision.lineofsight import LineOfSight
from follower_vision.track import TrackState

BodyAt = Callable[[float], BodyState]


class FlightTruth:
    """Takes the truth beside each control step, and holds tracks against it.

    Args:
        world: what there is.
        vehicle_at: gives the vehicle's body at a time.
        camera_at: gives the body that carries the camera.

    Attributes:
        samples: the truth, a sample a control step.
        tracked: what came of each frame in which the target was said to be seen.
    """

    def __init__(self, world: World, vehicle_at: BodyAt, camera_at: BodyAt) -> None:
        self.samples: list[TruthSample] = []
        self._cameras: dict[float, BodyState] = {}
        self.tracked: list[TrackedFrame] = []
        self._world = world
        self._vehicle_at = vehicle_at
        self._camera_at = camera_at
        self._teller = TruthTeller(world)
        self._told: tuple[float, SeenBody] | None = None

    def take(self, now_s: float) -> TruthSample:
        """Take and return the truth of now."""
        body, camera = self._vehicle_at(now_s), self._camera_at(now_s)
        sample = self._teller.sample(now_s, body, camera=camera)
        self.samples.append(sample)
        self._cameras[now_s] = camera
        return sample

    def box_sight(self, sample: TruthSample) -> LineOfSight:
        """Work out the direction of the true box's middle for one of the samples."""
        camera = self._cameras[sample.time_s]
        truth = self._teller.truth(sample.time_s, sample.vehicle, camera)
        return self._teller.box_sight(truth, sample.vehicle, camera)

    def compare(self, record: TrackRecord) -> None:
        """Compare a track that claims to see the target with the truth, for the score."""
        track = record.track
        if track is None or track.state is not TrackState.TRACKING:
            return
        box = self.of_frame(record.captured_s).box
        overlap = 0.0 if box is None else box.iou(track.box)
        others = [other.iou(track.box) for other in self._others(record.captured_s)]
        frame = TrackedFrame(record.captured_s, overlap, max(others, default=0.0))
        self.tracked.append(frame)

    def of_frame(self, stamp_s: float) -> SeenBody:
        """Return where the target truly is in a frame with this capture stamp."""
        if self._told is not None and self._told[0] == stamp_s:
            return self._told[1]
        true_s = self._true_time(stamp_s)
        seen = self._teller.seen(true_s, self._camera_at(true_s))
        self._told = stamp_s, seen
        return seen

    @property
    def identity(self) -> IdentityScore:
        """What has become of the target's identity."""
        return identity_score(self.samples, self.tracked, len(self._world.paths) > 1)

    def _others(self, stamp_s: float) -> list[Box]:
        """Return the true boxes of the targets that are not followed."""
        if len(self._world.paths) == 1:
            return []
        true_s = self._true_time(stamp_s)
        return self._teller.others(true_s, self._vehicle_at(true_s), self._camera_at(true_s))

    def _true_time(self, stamp_s: float) -> float:
        return stamp_s - self._world.scenario.camera.stamp_offset_s
