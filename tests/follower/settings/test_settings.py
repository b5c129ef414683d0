"""Settings: what is right is taken, what is mistyped is named."""

import dataclasses
import math
from pathlib import Path

import pytest
import yaml
from small_scenario import small_scenario

from follower.apps.video_input import VideoInput
from follower.settings.field_docs import explained_keys, explained_yaml
from follower.settings.settings import CameraSettings, Settings, load_settings, scenario_files
from follower.tuning.identify.result import VehicleFile
from follower_control.common.strict_config import SettingsError
from follower_sim.scenario.scenario import Scenario


def _file(folder: Path, text: str) -> Path:
    path = folder / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_defaults_are_complete_and_come_back_from_their_own_yaml() -> None:
    settings = load_settings()
    assert load_settings(base=yaml.safe_load(settings.to_yaml())) == settings


def test_the_file_overrides_the_base_and_the_command_line_overrides_both(tmp_path: Path) -> None:
    path = _file(tmp_path, "servo: {distance_m: 12}\n")
    base = {"servo": {"distance_m": 9, "max_yaw_rate_deg_s": 30}}
    settings = load_settings(path, base, ["servo.azimuth.kp=2.5"])
    assert settings.servo.distance_m == 12
    assert settings.servo.max_yaw_rate_deg_s == 30
    assert settings.servo.azimuth.kp == 2.5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("servo: {distanse_m: 12}", r"unknown key 'servo.distanse_m'; did you mean 'distance_m'\?"),
        ("servoo: {}", r"unknown key 'servoo'; did you mean 'servo'\?"),
        ("servo: {azimuth: {kq: 1}}", r"unknown key 'servo.azimuth.kq'; did you mean 'kp'\?"),
        ("camera: {fov: 70}", r"unknown key 'camera.fov'; did you mean 'fov_deg'\?"),
        ("servo: {distance_m: fifteen}", r"servo.distance_m: 'fifteen' is no number; .*in metres"),
        ("servo: {max_forward_m_s: 36 km/h}", r"'36 km/h' is no number; .*, in metres a second$"),
        (
            "servo: {distance_m: 1500}",
            r"servo: distance_m lies between 0.0005 and 500, not 1500$",
        ),
        ("servo: {max_yaw_rate_deg_s: -3}", r"max_yaw_rate_deg_s lies between .*, not -3$"),
        ("servo: {distance_cm: 1500}", r"'servo.distance_cm'; did you mean 'distance_m'\?"),
        ("servo: 5", "servo: 5 is no section; write its keys below it"),
        ("start: {}\ntargets: []", "this is a scenario; fly it by `follower sim "),
        ("camera: {latency_s: 80}", "latency_s lies between -2 and 2, not 80"),
        ("control_rate_hz: [50]", "is no number; write one alone, in hertz"),
        ("fusion: {validate_every: 2.5}", "fusion.validate_every: 2.5 is no whole number$"),
        (
            "camera: {fov_deg: 70}\ntracker: corelation",
            "no 'corelation'; there are identity, correlation",
        ),
        ("camera: {fov_deg: 1.2}", "fov_deg lies between 4 and 179, not 1.2"),
        ("supervisor: {search_s: -1}", "search_s lies between 0.001 and 3600, not -1"),
        (
            "camera: {focal_px: 457, focal_width_px: 0}",
            "focal_width_px lies between 1 and 1",
        ),
        ("envelope: {max_speed_m_s: on}", r"max_speed_m_s: True is no number; .* a second$"),
        ("health: {gps_fix: off}", r"health.gps_fix: False is no number; write one alone"),
        ("camera: {center_px: [true, 9]}", r"camera.center_px\[0\]: True is no number"),
        ("camera: {fov_deg: 60, fov_deg: 70}", "line 1, column 23: 'fov_deg' stands in line 1"),
        (
            "envelope: {max_speed_m_s: 2}\ncamera: {fov_deg: 60}\nenvelope: {ceiling_m: 25}",
            "line 3, column 1: 'envelope' stands in line 1 already; put both together",
        ),
        ("envelope: {ceiling_m: 030}", "line 1, column 23: 030 could mean several numbers"),
        ("envelope: {ceiling_m: 1:30}", "1:30 could mean several numbers"),
        ("envelope: {ceiling_m: -1:30.5}", "-1:30.5 could mean several numbers"),
        ("[1, 2]", "expected a mapping"),
        ("servo: {", "no valid YAML: line 1, column 9: "),
    ],
)
def test_a_mistake_is_told_in_one_line_with_its_place(
    tmp_path: Path, text: str, message: str
) -> None:
    path = _file(tmp_path, text)
    with pytest.raises(SettingsError, match=message) as caught:
        load_settings(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_malformed_override_are_told() -> None:
    with pytest.raises(SettingsError, match=r"nowhere\.yaml: cannot be read"):
        load_settings("nowhere.yaml")
    with pytest.raises(SettingsError, match="write key=value"):
        load_settings(overrides=["servo.distance_m"])
    with pytest.raises(SettingsError, match=r"--set servo.x=1: unknown key 'servo.x'"):
        load_settings(overrides=["servo.x=1"])


def test_a_wrong_value_is_not_blamed_on_a_right_one_that_was_given_later(tmp_path: Path) -> None:
    path = _file(tmp_path, "servo: {distnce_m: 9}")
    with pytest.raises(SettingsError) as caught:
        load_settings(path, overrides=["servo.mode=watch"])
    assert str(caught.value).startswith(f"{path} with --set servo.mode=watch: unknown key")
    with pytest.raises(SettingsError, match=r"servo.x=1 --set servo.mode=watch: unknown key"):
        load_settings(overrides=["servo.x=1", "servo.mode=watch"])


def test_what_is_not_finite_is_refused() -> None:
    with pytest.raises(SettingsError, match="control_rate_hz"):
        load_settings(overrides=["control_rate_hz=.nan"])


def test_a_calibrated_focal_length_scales_with_the_image() -> None:
    camera = CameraSettings(focal_px=500.0, focal_width_px=640)
    assert camera.model(1280, 960).fx == pytest.approx(1000.0)


def test_a_field_of_view_reaches_from_edge_to_edge() -> None:
    model = CameraSettings(fov_deg=90.0).model(640, 480)
    left, right = model.rays([[0, 240], [640, 240]])
    assert math.degrees(math.acos(float(left @ right))) == pytest.approx(90.0)


def test_settings_cannot_be_changed_behind_ones_back() -> None:
    with pytest.raises(ValueError, match="frozen"):
        Settings().control_rate_hz = 10.0  # type: ignore[misc]


def test_one_override_may_stand_without_a_list() -> None:
    assert load_settings(overrides="servo.distance_m=12").servo.distance_m == 12


@pytest.mark.parametrize("loop", ["azimuth", "elevation", "range"])
def test_one_gain_given_leaves_the_loops_others_alone(loop: str) -> None:
    usual = getattr(Settings().servo, loop)
    changed = load_settings(overrides=[f"servo.{loop}.kp=0.123"])
    assert getattr(changed.servo, loop) == dataclasses.replace(usual, kp=0.123)
    assert load_settings() == Settings()


def test_every_section_refuses_unknown_keys() -> None:
    """Dataclass sections take the rule over from the model that holds them."""
    for model in (Settings, Scenario, VehicleFile):
        schema = model.model_json_schema()
        for name, part in {model.__name__: schema, **schema["$defs"]}.items():
            assert part["type"] != "object" or part["additionalProperties"] is False, name


def test_the_camera_s_source_is_used_with_its_password_and_shown_without() -> None:
    address = "rtsp://captain:se@cret@10.0.0.5/live?token=hidden"
    settings = load_settings(overrides=[f"camera.source={address}", "camera.capture.rate_hz=15"])
    assert VideoInput.camera(None, settings.camera).name == address
    assert VideoInput.camera("0", settings.camera).name == "0"
    assert VideoInput.camera("0", settings.camera).capture.rate_hz == 15
    assert "rtsp://10.0.0.5/live?token=" in settings.to_yaml()
    assert not any(word in settings.to_yaml() for word in ("captain", "cret", "hidden"))
    with pytest.raises(SettingsError, match=r"which source.*camera\.source"):
        VideoInput.camera(None, load_settings().camera)
    with pytest.raises(SettingsError, match=r"source=rtsp://10.0.0.5/live\?token= --set camera"):
        load_settings(overrides=[f"camera.source={address}", "camera.fps=15"])


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("formt=MJPG", "unknown key 'camera.capture.formt'; did you mean 'format'"),
        ("format=MOTION", "four characters such as MJPG, not 'MOTION'"),
        ("size=[0,480]", r"size is \[width, height\] in pixels, not \[0, 480\]"),
        ("rate_hz=-1", "rate_hz lies between 0 and 1000, not -1"),
        ("transport=sctp", "'tcp' or 'udp'"),
    ],
)
def test_a_capture_that_cannot_be_is_refused(override: str, says: str) -> None:
    with pytest.raises(SettingsError, match=says):
        load_settings(overrides=[f"camera.capture.{override}"])


def test_controls_keep_their_kinds() -> None:
    controls = "{gain: 10, auto_exposure: Manual Mode, white_balance_automatic: false}"
    settings = load_settings(overrides=[f"camera.capture.controls={controls}"])
    assert settings.camera.capture.controls == {
        "gain": 10,
        "auto_exposure": "Manual Mode",
        "white_balance_automatic": False,
    }


def test_settings_are_printed_with_what_they_mean_and_read_as_they_are() -> None:
    one = load_settings(overrides=["servo.distance_m=12.5", "camera.capture.controls={gain: 3}"])
    text = explained_yaml(one, one.to_yaml())
    assert load_settings(base=yaml.safe_load(text)) == one
    assert "  # wanted distance to the target.\n  distance_m: 12.5\n" in text
    assert [line for line in text.splitlines() if not line.lstrip().startswith("#")] == (
        one.to_yaml().splitlines()
    )
    explained = len([line for line in text.splitlines() if line.lstrip().startswith("#")])
    assert explained > 300
    assert "# The motion tracker, one of `follower trackers`.\ntracker: " in text
    assert max(map(len, text.splitlines())) <= 100


def test_settings_that_are_one_of_a_few_words_name_them_all_once() -> None:
    one = load_settings()
    text = " ".join(explained_yaml(one, one.to_yaml()).replace("#", "").split())
    assert "which way to follow. (chase | watch | side | orbit | overhead) mode: chase" in text
    assert "what follows on the hold. (hold | loiter | rtl | land | hand_back) action: hold" in text
    assert "(none | follow_target | global_position | both) target: none" in text
    assert "tcp, or udp, which drops what comes late. transport: tcp" in text  # it says so already


def test_no_value_is_called_as_a_file_has_to_say_it() -> None:
    one = load_settings()
    for text in (explained_yaml(one, one.to_yaml()), explained_keys(Scenario)):
        assert "None" not in text
    assert "null flies without GPS" in explained_yaml(one, one.to_yaml())


def keys_of(value: object, path: str = "") -> set[str]:
    """Return the paths of all keys in a mapping, those of a list's items alike."""
    if isinstance(value, list):
        return {path}.union(*(keys_of(one, path) for one in value))
    if not isinstance(value, dict) or path == ".follow":
        return {path}
    return set[str]().union(*(keys_of(inner, f"{path}.{key}") for key, inner in value.items()))


def test_all_keys_of_a_scenario_are_explained_with_their_defaults() -> None:
    text = explained_keys(Scenario)
    explained = yaml.safe_load(text)
    for path in scenario_files().values():
        assert keys_of(yaml.safe_load(path.read_text("utf-8"))) <= keys_of(explained), path
    defaults = Scenario.model_validate(yaml.safe_load(small_scenario(20))).model_dump(mode="json")
    for section in ("sky", "weather", "occlusions", "wind", "stand_in", "expect"):
        assert explained[section] == defaults[section]
    assert (
        "# how long the flight may last, in seconds. (number above 0 at most 86400, required)\n"
        in text
    )
    assert "    # (person | car | boat | quadrotor, required)\n    kind:\n" in text
    assert "  # Horizontal field of view, distortion left out. (number above 5 below 150)" in text


def test_a_scenarios_fault_begins_before_it_ends() -> None:
    turned = yaml.safe_load(small_scenario(20)) | {
        "faults": [{"kind": "black", "from_s": 9, "until_s": 4}]
    }
    with pytest.raises(ValueError, match="it ends at 4 s, before it begins"):
        Scenario.model_validate(turned)
