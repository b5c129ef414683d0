"""Settings that make no sense are refused where they are made, by their names."""

import math
from typing import Any

import pytest

from follower.settings.link import LinkSettings
from follower.settings.settings import CameraSettings
from follower.settings.supervisor import (
    ConsentSettings,
    HealthSettings,
    ReleaseSettings,
    StickSettings,
    SupervisorSettings,
)
from follower.settings.ui import CockpitSettings, GroundStationSettings, VideoSettings
from follower.training.re3.settings import TrainingStage
from follower.training.scenes.generator import SceneSettings
from follower.tuning.excite.pattern import ExcitationSettings
from follower_control.envelope.settings import EnvelopeSettings
from follower_control.servo.pid import PidSettings
from follower_control.servo.search import SearchSettings
from follower_control.servo.settings import ServoSettings
from follower_sim.noisy_tracker import NoisyTrackerSettings
from follower_vision.detection.detection import DetectorSettings
from follower_vision.selection import ColourSearchSettings
from follower_vision.sources.live_source import LiveSettings

BY_NAME: dict[type, list[dict[str, Any]]] = {
    EnvelopeSettings: [
        {"max_speed_m_s": 0.0},
        {"max_jerk_m_s3": math.nan},
        {"fence_radius_m": -1.0},
        {"min_height_m": 60.0},
        {"braking_m_s2": 5.0},
        {"max_interval_s": math.inf},
    ],
    CameraSettings: [{"distortion": (math.nan, 0.0, 0.0, 0.0, 0.0)}],
    SearchSettings: [
        *({"turn_rate_deg_s": 0.0}, {"look_s": -1.0}, {"sweep_deg": 200.0}, {"climb_m": math.nan}),
    ],
    ServoSettings: [
        {"distance_m": 0.0},
        {"target_size_m": -1.0},
        {"max_forward_m_s": math.inf},
        {"centred_deg": 40.0},
        {"elevation_deg": 91.0},
    ],
    SupervisorSettings: [{"search_s": value} for value in (0.0, -1.0, math.nan, math.inf)],
    ConsentSettings: [
        {"own_mode_s": 0.0},
        {"command_system": 0},
        {"rc_channel": 19},
        {"rc_threshold_us": 100},
        {"rc_timeout_s": math.nan},
    ],
    StickSettings: [
        {"deadband": 0.0},
        {"takeover": 0.05},
        {"max_distance_m": -1.0},
        {"max_bearing_deg": 90.0},
        {"throw_us": 0},
    ],
    ReleaseSettings: [{"retry_s": 0.0}],
    LinkSettings: [{"vehicle_id": 0}, {"vehicle_id": 256}, {"listen_s": -1.0}, {"stall_s": 1.0}],
    CockpitSettings: [
        *({"port": 70000}, {"host": " "}, {"tls_cert": "a.pem"}, {"lost_s": 0.1}),
        {"most_clients": 0},
    ],
    GroundStationSettings: [
        {"camera_component": 99},
        {"image_rate_hz": 0.0},
        {"target_rate_hz": math.nan},
        {"target_system": 0},
        {"video_uri": "rtsp://" + "a" * 160},
    ],
    SceneSettings: [{"width": 10}, {"least_scale": 1.0}, {"occlusion": 1.5}, {"blur": -0.1}],
    NoisyTrackerSettings: [{"centre_noise": -1.0}, {"size_factor": 0.0}, {"false_share": 1.5}],
    DetectorSettings: [
        *({"min_score": 1.1}, {"max_overlap": -0.1}, {"most": 0}),
    ],
}
BY_WORDS: list[tuple[type, str, dict[str, Any]]] = [
    *((PidSettings, "lies between", {"kp": 1.0} | wrong) for wrong in (
        {"kp": -1.0}, {"ki": math.nan}, {"tracking_s": 0.0}, {"cut_tolerance": -0.1},
        {"derivative_filter_s": math.inf},
    )),
    (StickSettings, "four sticks", {"roll_channel": 2}),
    (HealthSettings, "does not hold", {"battery_to_start": 0.1}),
    (HealthSettings, "does not hold", {"battery_to_start": 1.5}),
    (HealthSettings, "positive", {"stale_s": 0.0}),
    (HealthSettings, "positive", {"stale_s": math.inf}),
    (LinkSettings, "attitude|rates lie", {"attitude_rate_hz": 0.0}),
    (LinkSettings, "timesync|rates lie", {"timesync_rate_hz": math.nan}),
    *((VideoSettings, ".", wrong) for wrong in (
        {"udp": "5600"}, {"rtsp": "localhost"}, {"push": "http://x"},
        {"push": "rtsp://x:port/drone"}, {"push": "rtsp://"}, {"push": "rtsp://a:b@x/drone"},
        {"bitrate_kbit_s": 1}, {"keyframe_s": 0.0}, {"max_width_px": 10},
    )),
    *((ExcitationSettings, "within|axis", wrong) for wrong in (
        {"forward_m_s": -1.0}, {"yaw_deg_s": math.nan}, {"hold_s": 0.0},
        {"forward_m_s": 0, "right_m_s": 0, "vertical_m_s": 0, "yaw_deg_s": 0},
    )),
    (TrainingStage, "greater than 0", {"steps": 0}),
    (TrainingStage, "greater than 0", {"steps": 1, "rate": 0.0}),
    *((LiveSettings, "live source", wrong) for wrong in (
        {"retry_s": 0}, {"retry_s": 9}, {"first_frame_s": 0},
    )),
    *((ColourSearchSettings, "lies?|positive", wrong) for wrong in (
        {"hue_tolerance_deg": 0}, {"min_area_px": -1}, {"saturation_ratio": 2},
    )),
]  # fmt: skip
ALL = [(kind, "|".join(one), one) for kind, wrong in BY_NAME.items() for one in wrong] + BY_WORDS


@pytest.mark.parametrize(
    ("kind", "says", "wrong"), ALL, ids=[f"{kind.__name__}: {wrong}"[:60] for kind, _, wrong in ALL]
)
def test_settings_that_make_no_sense_are_refused(
    kind: type, says: str, wrong: dict[str, Any]
) -> None:
    with pytest.raises(ValueError, match=says):
        kind(**wrong)
