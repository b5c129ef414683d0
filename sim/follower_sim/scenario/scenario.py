"""A scenario as data: what a YAML file in configs/scenarios may say."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from follower_control.common.strict_config import check_ranges
from follower_sim.bodies.targets import TargetKind
from follower_sim.paths.path_generator import PathShape, drawn
from follower_sim.paths.spline import Corners, Course, SpeedChange, SpeedProfile, TargetPath
from follower_sim.scenario.weather import LowLightSettings, WeatherSettings
from follower_sim.vehicle.gimbal import GimbalModel
from follower_sim.vehicle.response import Drag
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.geometry.line_of_sight import CameraMount
from follower_vision.selection import ColourSearchSettings

_SHAPED_UNTIL_S = 80.0
_LONGEST_S = 3600.0


@dataclass(frozen=True, slots=True)
class Criteria:
    """Limits of a score; None asks for nothing.

    Attributes:
        min_in_frame_share: least share of the scored time with the target in frame.
        max_line_of_sight_rms_deg: largest root mean square of the line-of-sight error.
        max_median_range_error: largest median of the range error, as a share of the wanted range.
        max_acquire_s: longest time from the choice of the target to following it.
        max_approach_s: longest time from then on to the approach's end.
        max_losses: largest number of losses.
        max_found_again_s: longest time from when a hidden target is to be seen again until it is
            tracked; a target that is never found again breaks it, one that is never hidden not.
        max_mistaken_s: longest time for which another target may be tracked.
        max_wrong_box_share: largest share of tracked frames whose box misses the target.
    """

    min_in_frame_share: float | None = 0.99
    max_line_of_sight_rms_deg: float | None = 3.0
    max_median_range_error: float | None = 0.12
    max_acquire_s: float | None = 15.0
    max_approach_s: float | None = 30.0
    max_losses: int | None = None
    max_found_again_s: float | None = None
    max_mistaken_s: float | None = None
    max_wrong_box_share: float | None = 0.02

    def __post_init__(self) -> None:
        check_ranges(self, **{field.name: (0.0, 1e9) for field in fields(self)})
        check_ranges(self, min_in_frame_share=(0, 1), max_wrong_box_share=(0, 1))


@dataclass(frozen=True, slots=True)
class NoisyTrackerSettings:
    """How well the simulated tracker sees. Sizes are shares of the true box's side, √area.

    The noise is as measured of the correlation tracker's boxes on the scenarios `pursue-…`.

    Attributes:
        centre_noise: standard deviation of the centre's error, along each axis.
        size_noise: standard deviation of the error of the side's natural logarithm.
        noise_s: time within which both errors change (Gauss-Markov).
        offset: lasting error of the centre, (right, down): where the operator's choice lies.
        size_factor: side of the box over the true one's.
        least_visible: with less than this share of the target visible it is not seen.
        coast_s: how long a box is extrapolated before the target is lost.
        recognise_s: mean time from a lost target's coming back into view until it is recognised.
        false_share: share of the losses in which something else is taken for the target.
        false_after_s: mean time from such a loss until then.
        false_s: how long it is taken for it.
    """

    centre_noise: float = 0.04
    size_noise: float = 0.08
    noise_s: float = 1.5
    offset: tuple[float, float] = (0.0, 0.0)
    size_factor: float = 1.0
    least_visible: float = 0.4
    coast_s: float = 0.5
    recognise_s: float = 0.15
    false_share: float = 0.03
    false_after_s: float = 1.0
    false_s: float = 0.4

    def __post_init__(self) -> None:
        names = {field.name for field in fields(self)} - {"offset"}
        check_ranges(self, **dict.fromkeys(names, (0.0, 1e9)))
        check_ranges(self, size_noise=(0, 10), size_factor=(1e-6, 1e6))
        check_ranges(self, least_visible=(0, 1), false_share=(0, 1))


ColourText = Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$")]
"""A colour as "#rrggbb"."""

PlanePoint = tuple[float, float]
"""(north, east) in metres."""

CoursePoint = Annotated[list[float], Field(min_length=2, max_length=3)]
"""(north, east) or (north, east, height) in metres."""

Share = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


class _Section(BaseModel):
    """A part of a scenario: unknown keys are refused, nothing changes after loading."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class PathSettings(_Section):
    """A target's course and its speeds; without speeds it stands at the first point."""

    points: list[CoursePoint] = Field(default_factory=list)
    """Each [north, east] or [north, east, height], in metres."""
    shape: PathShape | None = None
    """In place of all the others: a way of moving, drawn from the seed."""
    corners: Corners = "winding"
    """A smooth curve through every point, or straight lines with arcs at the corners."""
    radius_m: Positive = 5.0
    """Of the arcs."""
    closed: bool = False
    """It returns to its first point and goes on."""
    speeds: list[SpeedChange] = Field(default_factory=list)
    """In their order; none: it stands."""

    @model_validator(mode="after")
    def _can_be_built(self) -> Self:
        if self.shape is not None and (self.points or self.speeds):
            raise ValueError("a path has either points and speeds or a shape")
        if any(point[2] < 0 for point in self.points if len(point) > 2):
            raise ValueError("a path's heights are 0 or more: below the ground nothing moves")
        self.build()
        return self

    def build(self, seed: int = 0, until_s: float = _SHAPED_UNTIL_S) -> TargetPath:
        """Return the path that these settings describe.

        Args:
            seed: by which a shape is drawn; points are what they are.
            until_s: how long a shape's path lasts at least.
        """
        plain = self.drawn(np.random.default_rng(seed), until_s)
        course = Course(plain.points, plain.corners, plain.radius_m, plain.closed)
        return TargetPath(course, SpeedProfile(plain.speeds))

    def drawn(self, rng: np.random.Generator, until_s: float) -> PathSettings:
        """Return the same with way points in the place of a shape."""
        if self.shape is None:
            return self
        return PathSettings(**drawn(self.shape, rng, until_s))


class TargetSettings(_Section):
    """One moving thing, followed or not."""

    kind: TargetKind
    colour: ColourText
    """As "#rrggbb"."""
    path: PathSettings


class RoadSettings(_Section):
    """A road painted on the ground: along a target's path, or through points of its own."""

    along: int | None = None
    """The number of the target along whose path it runs, from 0."""
    points: list[CoursePoint] | None = None
    """Or its own, as a path's."""
    corners: Corners = "winding"
    """As a path's."""
    radius_m: Positive = 5.0
    """Likewise."""
    width_m: Positive = 6.5
    surface: Literal["asphalt", "dirt"] = "asphalt"

    @model_validator(mode="after")
    def _one_course(self) -> Self:
        if (self.along is None) == (self.points is None):
            raise ValueError("a road needs either `along` (a target's number) or `points`")
        if self.points is not None:
            self.build_course()
        return self

    def build_course(self) -> Course:
        """Return the middle line of a road that has points of its own.

        Raises:
            ValueError: it has none.
        """
        return Course(self.points or [], self.corners, self.radius_m)


class GroundSettings(_Section):
    """What the ground looks like."""

    kind: Literal["meadow", "farmland", "desert", "water"] = "meadow"
    roads: list[RoadSettings] = Field(default_factory=list)


class SkySettings(_Section):
    """Sun, clouds and haze."""

    sun_azimuth_deg: float = 140.0
    """Clockwise from north."""
    sun_elevation_deg: Annotated[float, Field(gt=5, le=90)] = 48.0
    clouds: Share = 0.4
    """Share of the sky that they cover."""
    visibility_m: Positive = 900.0
    """Distance at which haze has taken 63 % of the contrast."""


SceneryKind = Literal[
    "broadleaf", "fir", "house", "bridge", "rock", "bale", "buoy", "canopy", "hall"
]


class SceneryItem(_Section):
    """One thing that stands: it hides what is behind it and casts a shadow."""

    kind: SceneryKind
    at: PlanePoint
    """[north, east] in metres."""
    heading_deg: float = 0.0
    """Clockwise from north."""
    size_m: Positive | None = None
    """Height of a tree, rock or buoy, length of a house, of a bridge's deck, a canopy or a hall."""
    height_m: Positive = 2.6
    """Of the space below a canopy or in a hall."""


class ScatterSettings(_Section):
    """Many things of one kind at random places, clear of roads, paths and the start."""

    kind: Literal["broadleaf", "fir", "house", "rock", "bale", "buoy"]
    count: Annotated[int, Field(ge=1, le=500)]
    clear_m: NotNegative = 10.0
    """Least distance from the paths."""
    within_m: Positive = 60.0
    """Farthest distance from the paths."""
    size_m: tuple[Positive, Positive] | None = None
    """Smallest and largest size."""

    @model_validator(mode="after")
    def _sizes_grow(self) -> Self:
        if self.size_m is not None and self.size_m[0] > self.size_m[1]:
            raise ValueError("size_m: the smallest size comes first")
        return self


class OcclusionSettings(_Section):
    """Roofs over the followed target's path, which hide it from a camera above them."""

    kind: Literal["canopy", "hall"] = "canopy"
    """Leaves on posts, or a building that the path runs through."""
    hidden_s: Annotated[float, Field(ge=0, le=_LONGEST_S)] = 0.0
    """How long the target takes to pass below each; or is hidden by it, with a `distance_m`."""
    count: Annotated[int, Field(ge=0, le=20)] = 2
    first_s: Annotated[float, Field(ge=0, le=_LONGEST_S)] = 26.0
    """When it comes to the first one."""
    every_s: Annotated[float, Field(gt=0, le=_LONGEST_S)] = 14.0
    """Time from one to the next."""
    clearance_m: Positive = 0.6
    """Between the target's top and a roof."""
    distance_m: Positive | None = None
    """Hide it from a vehicle that has followed it so far away and stops when it is hidden: from
    one that goes on, for less. None: the roofs stand above the target's way, wherever it is seen
    from."""
    down_deg: Annotated[float, Field(gt=0, lt=90)] = 25.0
    """So far above it that vehicle is, as an angle."""


class LookAlikeSettings(_Section):
    """Others of the followed target's kind and colour, which cross close behind it."""

    count: Annotated[int, Field(ge=0, le=10)] = 0
    first_s: NotNegative = 32.0
    """When the first one is nearest."""
    every_s: Positive = 9.0
    """Time from one to the next."""
    beside_m: Positive = 3.0
    """How near they come."""


class WindSettings(_Section):
    """A mean wind and gusts about it."""

    mean_m_s: Annotated[float, Field(ge=0, le=200)] = 0.0
    from_deg: float = 0.0
    """Where the mean wind comes from, clockwise from north."""
    gust_m_s: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Standard deviation of the gusts along each horizontal axis; vertically a third of it."""


class SimCameraSettings(_Section):
    """The simulated camera and its imperfections."""

    width: Annotated[int, Field(ge=32, le=4096)] = 640
    height: Annotated[int, Field(ge=32, le=4096)] = 480
    fov_deg: Annotated[float, Field(gt=5, lt=150)] = 75.0
    """Horizontal field of view, distortion left out."""
    pitch_deg: Annotated[float, Field(ge=-90, le=90)] = -20.0
    """Of the mount; negative looks down."""
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3 as OpenCV's calibration gives them."""
    gimbal: GimbalModel | None = None
    """Holds the camera, which looks along the nose and down by `pitch_deg` at first."""
    rate_hz: Annotated[float, Field(gt=0, le=240)] = 30.0
    exposure_s: NotNegative = 0.006
    """What moves in the image meanwhile is blurred."""
    blur_steps: Annotated[int, Field(ge=1, le=32)] = 4
    """A blurred picture is the mean of at most so many; each takes as long as a sharp one."""
    row_time_s: NotNegative = 0.0
    """From one row's exposure to the next one's (rolling shutter); 0 takes all at once."""
    noise: NotNegative = 2.5
    """Standard deviation in grey levels."""
    low_light: LowLightSettings = LowLightSettings()
    lens_dirt: Annotated[float, Field(ge=0, le=0.8)] = 0.0
    """Share of the image that dirt on the lens covers."""
    vignetting: Share = 0.15
    """Loss of brightness in the corners."""
    exposure_drift: Annotated[float, Field(ge=0, le=0.5)] = 0.06
    """Amplitude of slow brightness changes, as a share."""
    latency_s: Annotated[float, Field(ge=0, le=1)] = 0.05
    """From the middle of the exposure to the frame's arrival; the truth is kept for 2 s."""
    latency_jitter_s: Annotated[float, Field(ge=0, le=0.1)] = 0.004
    """Standard deviation of a normal error whose size is added to that."""
    jitter_s: NotNegative = 0.001
    """Standard deviation of the capture time about its schedule."""
    drop_probability: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """That a frame is lost."""
    stamp_offset_s: float = 0.0
    """Error of the frames' time stamps, unknown to the vision side."""

    @model_validator(mode="after")
    def _lens_reaches_its_corners(self) -> Self:
        corners = np.array([(0, 0), (self.width, 0), (0, self.height), (self.width, self.height)])
        imaged = self.model.pixels(self.model.rays(corners))
        if not np.allclose(imaged, corners, atol=0.5):
            raise ValueError("with this distortion the lens cannot image its own corners")
        return self

    @model_validator(mode="after")
    def _a_frame_ends_before_the_next(self) -> Self:
        parts = (
            ("exposure_s", self.exposure_s),
            ("row_time_s × height", self.row_time_s * self.height),
        )
        for name, takes_s in parts:
            if takes_s > 1 / self.rate_hz:
                raise ValueError(
                    f"{name} is {takes_s:.3g} s, longer than a frame's {1 / self.rate_hz:.3g} s at "
                    f"{self.rate_hz:g} Hz"
                )
        return self

    @property
    def model(self) -> CameraModel:
        """The camera model."""
        fov = math.radians(self.fov_deg)
        return CameraModel.from_fov(self.width, self.height, fov, self.distortion)

    @property
    def mount(self) -> CameraMount:
        """How the camera is turned against the body that carries it: the vehicle's, or its own."""
        if self.gimbal is not None:
            return CameraMount()
        return CameraMount(pitch_rad=math.radians(self.pitch_deg))


class FaultSettings(_Section):
    """A fault of the camera, or the followed target taken out of the world, for some time."""

    kind: Literal["black", "frozen", "silent", "shaken", "target_removed"]
    """`shaken`: the camera trembles during long exposures, so that its pictures are blurred."""
    from_s: NotNegative
    """When it begins."""
    until_s: Positive = 1e9
    """When it ends."""

    @model_validator(mode="after")
    def _begins_before_it_ends(self) -> Self:
        if self.until_s <= self.from_s:
            raise ValueError(f"it ends at {self.until_s:g} s, before it begins")
        return self


class VehicleSettings(_Section):
    """The airframe that flies."""

    drag: Drag | None = None
    """None is what the recorded vehicles have; that of PX4's own simulator is several times a real
    one's, so that it cannot fly in strong wind."""


_StartPlace = Annotated[float, Field(ge=-1e5, le=1e5)]
"""Farther from home the autopilot's latitude and longitude end."""


class StartSettings(_Section):
    """Where the vehicle stands before it takes off."""

    at: tuple[_StartPlace, _StartPlace]
    """[north, east] in metres."""
    heading_deg: float = 0.0
    """Clockwise from north."""


class SelectSettings(_Section):
    """How the operator points out the target: by what it looks like, never by its true place."""

    colour: ColourText
    """The target's, as "#rrggbb"."""
    search: ColourSearchSettings = ColourSearchSettings()


class Scenario(_Section):
    """A world, something to follow in it, and a camera on a drone.

    Time starts at 0 with the drone on the ground; targets move by their own clocks.

    Attributes:
        name: small letters, digits and hyphens.
        title: one sentence.
        duration_s: how long the flight may last, in seconds.
        seed: of everything random.
        ground: its kind and its roads.
        sky: sun, clouds and haze.
        weather: fog and rain.
        targets: what moves and can be followed.
        followed: the number of the target that the score is about, from 0.
        scenery: single things that stand on the ground.
        scatter: many things, placed at random.
        occlusions: what hides the target, and for how long.
        lookalikes: distractors of the target's kind.
        wind: mean, gusts and direction.
        faults: what goes wrong, and when.
        vehicle: the airframe.
        start: where the drone stands, north and east in metres, and its heading in degrees.
        takeoff_height_m: above the ground, in metres.
        select: how the operator points out the target.
    """

    name: Annotated[str, Field(pattern=r"^[a-z0-9-]+$")]
    title: str
    duration_s: Annotated[float, Field(gt=0, le=24 * _LONGEST_S)]
    seed: Annotated[int, Field(ge=0)] = 0
    ground: GroundSettings = GroundSettings()
    sky: SkySettings = SkySettings()
    weather: WeatherSettings = WeatherSettings()
    targets: list[TargetSettings] = Field(min_length=1)
    followed: Annotated[int, Field(ge=0)] = 0
    scenery: list[SceneryItem] = Field(default_factory=list)
    scatter: list[ScatterSettings] = Field(default_factory=list)
    occlusions: OcclusionSettings = OcclusionSettings()
    lookalikes: LookAlikeSettings = LookAlikeSettings()
    wind: WindSettings = WindSettings()
    camera: SimCameraSettings = SimCameraSettings()
    """The camera and its imperfections."""
    stand_in: NoisyTrackerSettings = NoisyTrackerSettings()
    """How well the simulated tracker sees in flights without pixels."""
    faults: list[FaultSettings] = Field(default_factory=list)
    vehicle: VehicleSettings = VehicleSettings()
    start: StartSettings
    takeoff_height_m: Positive = 8.0
    select: SelectSettings
    follow: dict[str, Any] = Field(default_factory=dict)
    """Settings of the follower, checked by the application."""
    expect: Criteria = Criteria()
    """What the pursuit has to reach."""

    @model_validator(mode="after")
    def _targets_exist(self) -> Self:
        numbers = [self.followed, *(r.along for r in self.ground.roads if r.along is not None)]
        for number in numbers:
            if not 0 <= number < len(self.targets):
                raise ValueError(f"there is no target number {number}")
        return self

    @model_validator(mode="after")
    def _paths_are_long_enough(self) -> Self:
        for number, target in enumerate(self.targets):
            short = target.path.build(0, self.duration_s).shortfall_m(self.duration_s)
            if short > 0:
                raise ValueError(
                    f"the path of target number {number} is {short:.0f} m too short for its speeds"
                )
        return self
