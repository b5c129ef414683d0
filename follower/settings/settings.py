"""All settings of the follower, parsed once from YAML; what goes inward is plain values."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, field_validator

from follower.settings.link import LinkSettings
from follower.settings.recorder import RecorderSettings
from follower.settings.supervisor import (
    ConsentSettings,
    HealthSettings,
    ReleaseSettings,
    StickSettings,
    SupervisorSettings,
)
from follower.settings.ui import CockpitSettings, GroundStationSettings, VideoSettings
from follower_control.common.strict_config import (
    SettingsError,
    StrictFields,
    check_ranges,
    load_yaml,
    merged,
    parse,
    read_mapping,
)
from follower_control.envelope.settings import EnvelopeSettings
from follower_control.servo.gimbal_servo import GimbalSettings
from follower_control.servo.search import SearchSettings
from follower_control.servo.settings import MODE_PLUGINS, FollowMode, ServoSettings
from follower_control.target.settings import EstimatorSettings
from follower_vision.fusion import FusionSettings
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.geometry.line_of_sight import CameraMount
from follower_vision.onnx_network import AUTO, accelerators
from follower_vision.sources.capture import CaptureSettings, without_password
from follower_vision.trackers.registry import is_tracker, tracker_names

_FITTED = "Fusion chooses by a fitted probability; see docs/explanation/fusion.md"
_FUSION_RULES = (
    *("zoomed_validation", "class_lock", "learn_box_ratio", "camera_motion", "score_coasting"),
    *("size_clamp", "distractor_memory", "appearance_check", "growing_search", "keep_template"),
    *("match_iou", "misses_to_lose", "low_ratio", "resume_ratio", "low_frames", "coast_s"),
    *("size_least", "size_most", "position_share", "size_share", "vote_looks", "doubt_ratio"),
    *("doubt_ratio_sure", "insist_s", "doubt_s", "doubt_score", "search_growth_s"),
    *("size_change_found", "reidentify", "blur"),
)
RETIRED = {
    "appearance": "Fusion compares the motion tracker's own features; leave it out",
    "fusion.prospects": "write fusion.target_prediction",
    "fusion.validate_steady_every": "write fusion.validate_every",
    "fusion.validate_blurred_every": "write fusion.doubt_every",
    "fusion.search_every": "write fusion.doubt_every",
    **{f"fusion.{name}": _FITTED for name in _FUSION_RULES},
    "longterm": "without a detector the target is followed by Fusion too; leave it out",
    "ground_station.definition_uri": "PARAM_* of component 191 offers the settings; leave it out",
}
"""What to do instead of each key, by its path."""
_BEFORE = {"envelope": {"max_yaw_jerk_deg_s3": None}, "vision": {"precision": "full"}}
"""What was flown before there were these settings: a recording without them means that."""


def refuse_retired(data: Mapping[str, Any], source: str) -> None:
    """Refuse settings that hold a retired key.

    Raises:
        SettingsError: names the source, the key and what to do instead.
    """
    for key in _paths(data):
        if key in RETIRED:
            raise SettingsError(f"{source}: {key} is gone: {RETIRED[key]}")


def as_recorded(recorded: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a recording, maybe of a former version, as those of this one."""
    return merged(_BEFORE, _without_retired(recorded))


def _without_retired(recorded: Mapping[str, Any], section: str = "") -> dict[str, Any]:
    """Return the settings of a recording without the keys that are retired by now.

    Args:
        recorded: the settings, or one section of them.
        section: the path of that section with its dot, "" for all settings.
    """
    kept = {key: value for key, value in recorded.items() if f"{section}{key}" not in RETIRED}
    return {
        key: _without_retired(value, f"{section}{key}.") if isinstance(value, Mapping) else value
        for key, value in kept.items()
    }


def _paths(data: Mapping[str, Any], section: str = "") -> Iterator[str]:
    for key, value in data.items():
        yield f"{section}{key}"
        if isinstance(value, Mapping):
            yield from _paths(value, f"{section}{key}.")


_LEAST_FOV_DEG = 4.0  # above pi: an angle in radians does not pass; a longer lens has focal_px


@dataclass(frozen=True, slots=True)
class VisionSettings(StrictFields):
    """Where the networks run.

    Attributes:
        device: cpu, cuda, tensorrt, openvino, coreml, qnn and others that onnxruntime has; auto
            takes the first accelerator that starts and answers as the processor does. One that
            fails in flight gives way to the processor in the same frame.
        precision: auto takes a network that `follower models quantise` made and found as good and
            faster, where there is one; full never does.
    """

    device: str = AUTO
    precision: Literal["auto", "full"] = "auto"

    def __post_init__(self) -> None:
        accelerators(self.device)


def _shown(source: str | None) -> str | None:
    return None if source is None else without_password(source)


@dataclass(frozen=True, slots=True)
class CameraSettings(StrictFields):
    """The camera: which one, its lens, how it is mounted, how late its frames are stamped.

    Attributes:
        source: which camera, where no command names one: `--camera` says how it is written. A
            password in it is used, and never shown.
        capture: what it is asked for.
        fov_deg: horizontal field of view; used unless `focal_px` is given.
        focal_px: focal length in pixels at `focal_width_px`, from a calibration.
        focal_width_px: image width for which `focal_px` and `center_px` hold.
        center_px: where the optical axis meets the image, from its top left corner, as
            `follower calibrate` finds it; None is the image's middle.
        distortion: k1, k2, p1, p2, k3 as OpenCV's calibration gives them.
        roll_deg: how the camera is rolled against the body; right side down is positive.
        pitch_deg: how it is pitched; looking down is negative.
        yaw_deg: how it is turned; to the right is positive.
        latency_s: how much later than the exposure a frame's time stamp is.
        frame_size: width and height in pixels of the frames for which all this holds; frames of
            another size are then refused. None takes any.
    """

    source: Annotated[str | None, PlainSerializer(_shown)] = None
    capture: CaptureSettings = field(default_factory=CaptureSettings)
    fov_deg: float = 70.0
    focal_px: float | None = None
    focal_width_px: int = 640
    center_px: tuple[float, float] | None = None
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    latency_s: float = 0.0
    frame_size: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        check_ranges(
            self,
            fov_deg=(_LEAST_FOV_DEG, 179),
            focal_px=(1, 1e5),
            focal_width_px=(1, 1e5),
            latency_s=(-2, 2),
            **dict.fromkeys(("roll_deg", "pitch_deg", "yaw_deg"), (-180, 180)),
        )
        if self.center_px is not None and not self._is_inside(*self.center_px):
            raise ValueError(
                f"center_px lies in an image {self.focal_width_px} px wide, not at {self.center_px}"
            )
        if not all(map(math.isfinite, self.distortion)):
            raise ValueError(f"distortion is five finite numbers, not {list(self.distortion)}")
        if self.frame_size is not None and not min(self.frame_size) > 0:
            raise ValueError(f"frame_size is [width, height] in pixels, not {self.frame_size}")

    @property
    def mount(self) -> CameraMount:
        """The mount's angles in radians."""
        return CameraMount(
            math.radians(self.roll_deg), math.radians(self.pitch_deg), math.radians(self.yaw_deg)
        )

    @property
    def view_rad(self) -> float:
        """How wide the camera sees, without what the lens distorts."""
        if self.focal_px is None:
            return math.radians(self.fov_deg)
        return 2 * math.atan(self.focal_width_px / 2 / self.focal_px)

    def model(self, width: int, height: int) -> CameraModel:
        """Return the intrinsics for images of this size."""
        if self.focal_px is None:
            lens = CameraModel.from_fov(width, height, math.radians(self.fov_deg), self.distortion)
            focal = lens.fx
        else:
            focal = self.focal_px * width / self.focal_width_px
        x, y = width / 2, height / 2
        if self.center_px is not None:
            x, y = (place * width / self.focal_width_px for place in self.center_px)
        return CameraModel(width, height, focal, focal, x, y, self.distortion)

    def model_of(self, source: str, width: int, height: int) -> CameraModel:
        """Return the intrinsics for what comes from a source.

        Raises:
            SettingsError: the settings are for frames of another size.
        """
        if self.frame_size is not None and self.frame_size != (width, height):
            described = "{}x{}".format(*self.frame_size)
            raise SettingsError(
                f"{source}: frames are {width}x{height}, camera.frame_size says {described}: "
                "give the lens for this size, or leave frame_size out"
            )
        return self.model(width, height)

    def _is_inside(self, x: float, y: float) -> bool:
        return 0 < x < self.focal_width_px and 0 < y < 2 * self.focal_width_px


class Settings(BaseModel):
    """Everything that can be set; the sections stand beside the laws that they belong to.

    Attributes:
        camera: lens, mount and latency.
        estimator: the Kalman filter of the target.
        servo: the follow mode, the gains and the wanted distance.
        vision: where the networks run.
        gimbal: whether there is one, and its limits.
        envelope: limits of the setpoints.
        health: battery, estimator and GPS: from when on following is refused or ended.
        supervisor: times of the supervisor.
        consent: the second consent beside the pilot's mode.
        sticks: stick offsets, and the deflection that takes over.
        search: how a lost target is looked for.
        release: what the autopilot does after a release.
        link: message rates, signing and system identifiers.
        recorder: what a recording holds.
        ground_station: the MAVLink camera and the parameters.
        cockpit: address and access of the web page.
        control_rate_hz: control steps a second.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    camera: CameraSettings = CameraSettings()
    tracker: str = "correlation"
    """The motion tracker, one of `follower trackers`."""
    detector: str | None = None
    """The object detector that validates the motion tracker, one of `follower models list` or a
    file; None does without one."""
    fusion: FusionSettings = FusionSettings()
    """How the target is chosen among what both propose."""
    vision: VisionSettings = VisionSettings()
    estimator: EstimatorSettings = EstimatorSettings()
    servo: ServoSettings = ServoSettings()
    gimbal: GimbalSettings = GimbalSettings()
    envelope: EnvelopeSettings = EnvelopeSettings()
    health: HealthSettings = HealthSettings()
    supervisor: SupervisorSettings = SupervisorSettings()
    consent: ConsentSettings = ConsentSettings()
    sticks: StickSettings = StickSettings()
    search: SearchSettings = SearchSettings()
    release: ReleaseSettings = ReleaseSettings()
    link: LinkSettings = LinkSettings()
    recorder: RecorderSettings = RecorderSettings()
    ground_station: GroundStationSettings = GroundStationSettings()
    video: VideoSettings = VideoSettings()
    """Live video that goes out."""
    cockpit: CockpitSettings = CockpitSettings()
    control_rate_hz: float = Field(default=50.0, ge=5, le=500)
    autonomy: Literal["pilot", "full"] = "pilot"
    """Who arms, takes off and changes the mode in `follower fly` and `follower sim`: "pilot" is a
    person; "full" is the program, for SITL and simulators alone."""
    takeoff_height_m: float = Field(default=10.0, gt=0, le=100)
    """How high to take off with `autonomy: full`."""

    @field_validator("tracker")
    @classmethod
    def _tracker_exists(cls, name: str) -> str:
        if not is_tracker(name):
            raise ValueError(f"there is no {name!r}; there are {', '.join(tracker_names())}")
        return name

    def to_yaml(self) -> str:
        """Return the settings as resolved, in the form in which they are read."""
        return yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False)


def load_settings(
    path: str | Path | None = None,
    base: Mapping[str, Any] | None = None,
    overrides: Iterable[str] = (),
) -> Settings:
    """Resolve settings: defaults, then `base`, then the file, then each `key.path=value`.

    A section that is given in part keeps the rest of its own defaults: `servo.range.kp=0.4` leaves
    the range loop's other gains alone.

    Raises:
        SettingsError: a file, key or value cannot be used; one line says which and why.

    Examples:
        >>> import follower
        >>> settings = follower.load_settings(overrides=["servo.distance_m=12"])
        >>> settings.servo.distance_m, settings.envelope.max_speed_m_s > 0
        (12.0, True)
    """
    data, source = settings_data(path, base, overrides)
    refuse_retired(data, source)
    settings = parse(Settings, merged(_defaults(), data), source)
    if "servo" in data:
        MODE_PLUGINS.names(tuple(FollowMode))  # warns of a mode that has a built-in one's name
    return settings


@cache
def _defaults() -> dict[str, Any]:
    return Settings().model_dump(mode="json")


def settings_data(
    path: str | Path | None = None,
    base: Mapping[str, Any] | None = None,
    overrides: Iterable[str] = (),
) -> tuple[dict[str, Any], str]:
    """Return what was really said, without the defaults, and where it was said.

    Raises:
        SettingsError: a file or an override cannot be read.
    """
    data: dict[str, Any] = merged({}, base or {})
    overrides = (overrides,) if isinstance(overrides, str) else tuple(overrides)
    said = without_password(" ".join(f"--set {override}" for override in overrides))
    source = said or "settings"
    if path is not None:
        source = f"{path} with {said}" if said else str(path)
        data = merged(data, read_mapping(path))
        if {"targets", "start"} <= data.keys():
            raise SettingsError(f"{path}: this is a scenario; fly it by `follower sim {path}`")
    for override in overrides:
        data = merged(data, _override(override))
    return data, source


def _override(text: str) -> dict[str, Any]:
    key, separator, value_text = text.partition("=")
    if not separator or not key:
        raise SettingsError(f"--set {text}: write key=value, for example servo.distance_m=12")
    try:
        value: Any = load_yaml(value_text)
    except yaml.YAMLError:
        raise SettingsError(f"--set {text}: the value is no valid YAML") from None
    return nested(key.split("."), value)


def nested(path: Sequence[str], value: Any) -> dict[str, Any]:
    """Return a mapping in mappings with a value at the end of the path of keys."""
    for key in reversed(path):
        value = {key: value}
    return dict(value)


def configs_folder() -> Path:
    """Return the folder with the files of `configs/`."""
    installed = Path(__file__).parents[1] / "_configs"
    return installed if installed.is_dir() else Path(__file__).parents[2] / "configs"


def scenario_files() -> dict[str, Path]:
    """Return the scenarios that come with the project, by name."""
    return {path.stem: path for path in sorted((configs_folder() / "scenarios").glob("*.yaml"))}


def find_scenario(text: str) -> Path:
    """Return the file of a scenario given by its path or by the name of one that comes along.

    Raises:
        SettingsError: there is neither.
    """
    path = Path(text)
    if path.suffix in (".yaml", ".yml") or path.is_file():
        return path
    known = scenario_files()
    if text not in known:
        raise SettingsError(
            f"there is no scenario {text!r}: give a YAML file, or one of {', '.join(known)}"
        )
    return known[text]
