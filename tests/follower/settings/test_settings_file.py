"""Changed settings go back into the user's file, and nothing else in it changes."""

from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from follower.flight.operator_requests import OperatorRequests
from follower.flight.target.request import RequestRefusedError
from follower.settings.live import SettingChange, live_keys, value_at
from follower.settings.save import save_settings, with_values
from follower.settings.settings import Settings, load_settings
from follower_control.common.strict_config import SettingsError

CONFIGS = Path(__file__).parents[3] / "configs"
MINE = """\
# My drone, my numbers.
tracker: correlation
servo:
  distance_m: 20   # the gate is narrow
  # Turn gently.
  azimuth:
    kp: 1.2
    ki: 0.0  # none
  range: {kp: 0.4}

envelope:
  ceiling_m: null
# The end.
"""


def test_a_value_is_replaced_and_every_comment_stays() -> None:
    after = with_values(MINE, {"servo.distance_m": 12.5, "servo.azimuth.kp": 0.7})
    assert after == MINE.replace("20 ", "12.5 ").replace("1.2", "0.7")


def test_a_missing_value_is_added_to_its_section() -> None:
    after = with_values(MINE, {"servo.azimuth.kd": 0.1, "servo.range.ki": 0.02})
    assert after == MINE.replace("# none\n", "# none\n    kd: 0.1\n").replace(
        "{kp: 0.4}", "{kp: 0.4, ki: 0.02}"
    )


def test_a_missing_section_is_added() -> None:
    after = with_values(MINE, {"search.sweep_deg": 30.0, "servo.elevation.kp": 0.5})
    data = yaml.safe_load(after)
    assert data["search"] == {"sweep_deg": 30.0}
    assert data["servo"]["elevation"] == {"kp": 0.5}
    kept = [line for line in MINE.splitlines() if line in after.splitlines()]
    assert kept == MINE.splitlines()


@pytest.mark.parametrize("text", ["", "# nothing yet\n", "servo:\n", "servo: {}\n", "servo: # a\n"])
def test_what_is_empty_is_filled(text: str) -> None:
    after = with_values(text, {"servo.azimuth.kp": 1e-05, "servo.mode": "orbit"})
    assert yaml.safe_load(after)["servo"] == {"azimuth": {"kp": 1e-05}, "mode": "orbit"}


@pytest.mark.parametrize(
    "text", ["servo: [1, 2]\n", "- 1\n", "servo: *gone\n", "a: &x {kp: 1}\nservo: *x\n"]
)
def test_what_cannot_be_edited_is_left_alone(text: str) -> None:
    with pytest.raises(SettingsError):
        with_values(text, {"servo.azimuth.kp": 1.0})


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("fly/*.yaml")), ids=lambda path: path.stem)
def test_our_own_examples_can_be_edited(path: Path, tmp_path: Path) -> None:
    copy = tmp_path / path.name
    copy.write_text(path.read_text("utf-8"), "utf-8")
    save_settings(copy, {"servo.azimuth.kp": 0.77, "supervisor.hold_s": 2.5})
    saved = load_settings(copy)
    assert saved.servo.azimuth.kp == 0.77
    assert saved.supervisor.hold_s == 2.5
    before = [line for line in path.read_text("utf-8").splitlines() if "#" in line]
    after = copy.read_text("utf-8").splitlines()
    assert sum(line in after for line in before) >= len(before) - 1


keys = st.lists(st.sampled_from([one.key for one in live_keys()]), min_size=1, max_size=6)


@pytest.mark.slow
@settings(max_examples=25)
@given(keys)
def test_whatever_is_changed_and_saved_is_in_force_when_read_again(chosen: list[str]) -> None:
    requests = OperatorRequests(load_settings(base=yaml.safe_load(MINE)))
    for key in chosen:
        value = value_at(requests.settings, key)
        lower = 0.99 * value if key.startswith("servo") and isinstance(value, float) else value
        requests.change(key, lower, "me")
    values = {key: SettingChange.of(key, one).plain for key, one in requests.changed.items()}
    assert load_settings(base=yaml.safe_load(with_values(MINE, values))) == requests.settings


def test_requests_are_saved_to_the_file_of_the_flight(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(MINE, "utf-8")
    path.chmod(0o640)
    requests = OperatorRequests(load_settings(path))
    requests.change("servo.distance_m", 11.0, "a test")
    requests.change("servo.mode", "orbit", "a test")
    assert requests.save(path) == "2 changed settings saved to mine.yaml"
    assert load_settings(path) == requests.settings
    assert path.stat().st_mode & 0o777 == 0o640
    assert [one.name for one in tmp_path.iterdir()] == ["mine.yaml"]


def test_without_a_file_it_is_said_so(tmp_path: Path) -> None:
    requests = OperatorRequests(Settings())
    with pytest.raises(RequestRefusedError, match="-c"):
        requests.save(None)
    with pytest.raises(RequestRefusedError, match="No such file"):
        requests.save(tmp_path / "gone.yaml")


def test_a_link_to_the_file_stays_one(tmp_path: Path) -> None:
    file, link = tmp_path / "real.yaml", tmp_path / "drone.yaml"
    file.write_text(MINE, "utf-8")
    link.symlink_to(file)
    save_settings(link, {"servo.distance_m": 12.5})
    assert link.is_symlink()
    assert "distance_m: 12.5" in file.read_text("utf-8")


def test_a_file_from_windows_keeps_the_ends_of_its_lines(tmp_path: Path) -> None:
    file = tmp_path / "drone.yaml"
    file.write_bytes(MINE.replace("\n", "\r\n").encode())
    save_settings(file, {"servo.distance_m": 12.5, "supervisor.hold_s": 2.0})
    data = file.read_bytes()
    assert data.count(b"\r\n") == data.count(b"\n") > MINE.count("\n")
