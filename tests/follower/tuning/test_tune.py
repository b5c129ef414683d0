"""`follower tune` writes settings that are taken, and tells what the gains survive."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from follower.settings.settings import configs_folder, load_settings
from follower.tuning.identify.result import load_vehicle
from follower.tuning.tune.analysis import analyse, conditions_of, parse_what_ifs
from follower.tuning.tune.report import nyquist, responses, worth
from follower.tuning.tune.run import TuneOptions, elevation_deg, find_vehicle, tune_follower
from follower_control.common.strict_config import SettingsError
from follower_control.tuning.axes import Axis
from follower_control.tuning.axis_loop import Conditions

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def tuned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    base = tmp_path_factory.mktemp("tune")
    mine = base / "mine.yaml"
    mine.write_text("servo: {distance_m: 11, azimuth: {kp: 0.7, bumpless_s: 0.3}}\n")
    options = TuneOptions(
        "ardupilot",
        mine,
        scenario="winding",
        bandwidths=("elevation=0.8",),
        max_sensitivity=1.5,
        what_ifs=("delay=0.15", "gain=9,dead_time=0.3"),
        out=base / "runs",
        command="follower tune\nardupilot",
    )
    assert tune_follower(options) == 0
    return base / "runs" / "tune"


def test_what_it_writes_is_taken_as_settings_and_keeps_everything_else(tuned: Path) -> None:
    settings = load_settings(tuned / "tuned.yaml")
    assert settings.servo.distance_m == 11
    assert settings.servo.azimuth.bumpless_s == 0.3
    assert settings.servo.azimuth.kp != 0.7
    # A section of gains is written whole, or what is left out would fall back to zero.
    defaults = load_settings().servo
    assert settings.servo.range.cut_tolerance == defaults.range.cut_tolerance
    assert (tuned / "tuned.yaml").read_text().startswith("# Gains by: follower tune ardupilot")


def test_the_written_gains_keep_ms_and_the_wanted_bandwidth(tuned: Path) -> None:
    base = {"servo": {"range_from": "ground", "target_middle_m": 0.4, "elevation_deg": -25}}
    settings = load_settings(tuned / "tuned.yaml", base)
    vehicle = find_vehicle("ardupilot")
    found = analyse(settings, vehicle.model(), conditions_of(settings, vehicle, -25.0), None)
    for one in found:
        assert one.tuned is None
        assert one.now.is_stable()
        assert one.now.margins().max_sensitivity <= 1.5 + 0.01
    elevation = next(one for one in found if one.axis is Axis.ELEVATION)
    assert elevation.now.bandwidth_rad_s() == pytest.approx(0.8, rel=0.1)


def test_the_report_opens_and_shows_every_loop(tuned: Path) -> None:
    page = (tuned / "tuning.html").read_text("utf-8")
    assert page.count("<svg") == 3 * len(Axis)
    assert "unstable" in page  # nine times the gain and 0.3 s more
    assert "delay=0.15" in page
    assert "Age of the position" not in page  # no loop depends on it
    assert "http" not in page.replace("http-equiv", "")


@pytest.mark.parametrize("name", ["px4", "ardupilot"])
def test_the_vehicles_that_come_along_are_whole_and_held_out_well(name: str) -> None:
    vehicle = find_vehicle(name)
    vehicle.model()
    for axis in vehicle.vehicle:
        assert vehicle.evidence[axis.value]["held_out_fit"] > 0.8


def test_what_ifs_change_what_they_name() -> None:
    here = Conditions()
    late, wrong, far = parse_what_ifs(
        ["delay=0.2", "stamp_error=0.1,camera_rate=15", "range=40,gain=2"], here
    )
    assert late.conditions.delays == replace(here.delays, camera_s=0.2)
    assert wrong.conditions.delays.stamp_error_s == 0.1
    assert wrong.conditions.delays.frame_interval_s == pytest.approx(1 / 15)
    assert (far.conditions.range_m, far.gain) == (40.0, 2.0)
    one, other = parse_what_ifs(["delay=0.05,stamp_error=0.1", "stamp_error=0.1,delay=0.05"], here)
    assert one.conditions == other.conditions


def test_a_known_delay_takes_hardly_any_margin_and_dead_time_takes_it_from_every_loop() -> None:
    """Our own motion is told at once: what the camera sees late is the target's, nearly alone."""
    settings, vehicle = load_settings(), find_vehicle("px4")
    here = conditions_of(settings, vehicle, -20.0)
    what_ifs = parse_what_ifs(["delay=0.3", "dead_time=0.3"], here)
    for one in analyse(settings, vehicle.model(), here, None, what_ifs):
        now, late, slow = one.now.margins(), *(what_if.margins() for _, what_if in one.what_ifs)
        assert late.gain == pytest.approx(now.gain, rel=0.1)
        assert slow.gain < now.gain


@pytest.mark.parametrize(
    "wrong",
    [
        *("dealy=0.1", "delay=soon", "delay=-1", "delay=nan", "gain=0", "gain=1e-300"),
        *("range=0", "camera_rate=0"),
    ],
)
def test_a_what_if_that_makes_no_sense_is_refused(wrong: str) -> None:
    with pytest.raises(SettingsError, match="--what-if"):
        parse_what_ifs([wrong], Conditions())


def test_a_what_if_with_gains_that_no_loop_can_have_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="--what-if range=1e9: range: kp lies between"):
        tune_follower(TuneOptions("px4", what_ifs=("range=1e9",), out=tmp_path))


def test_a_loop_without_proportional_gain_gets_one(tmp_path: Path) -> None:
    """Its derivative alone, as after `--set servo.range.kp=0`."""
    none = ("servo.range.kp=0", "servo.range.ki=0")
    assert tune_follower(TuneOptions("px4", overrides=none, out=tmp_path)) == 0
    assert load_settings(tmp_path / "tune" / "tuned.yaml").servo.range.kp > 0.1


def test_a_folder_is_the_vehicle_that_was_identified_in_it_or_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for folder in ("px4", "excite", "identify"):
        Path(folder).mkdir()
    mine = changed_vehicle(Path("identify"), delays={"camera_s": 0.3})
    assert find_vehicle("identify") == load_vehicle(mine)
    assert find_vehicle("px4").delays.camera_s == pytest.approx(0.074, abs=1e-3)
    with pytest.raises(SettingsError, match=r"give the vehicle\.yaml of `follower identify`"):
        find_vehicle("excite")


def test_what_is_named_next_flies_the_vehicle_that_the_gains_are_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert tune_follower(TuneOptions("ardupilot", out=tmp_path)) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Next: follower sim winding --lockstep --autopilot ardupilot -c" in said


def test_what_is_no_vehicle_or_wish_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="there is no vehicle 'px5'"):
        find_vehicle("px5")
    with pytest.raises(SettingsError, match="cannot be read"):
        load_vehicle(tmp_path / "none.yaml")
    for bandwidths, ms in ((("yaw=1",), 1.6), (("range=fast",), 1.6), (("range=0",), 1.6), ((), 9)):
        with pytest.raises(SettingsError, match="--"):
            TuneOptions("px4", bandwidths=bandwidths, max_sensitivity=ms).goals()


def test_an_unstable_loop_is_called_so_and_given_no_margins() -> None:
    settings, vehicle = load_settings(), find_vehicle("px4")
    here = conditions_of(settings, vehicle, -20.0)
    found = analyse(settings, vehicle.model(), here, None, parse_what_ifs(["gain=20"], here))
    assert all(worth(one.what_ifs[0][1])[0] == "unstable" for one in found)
    figure = responses(found[0])
    assert any("unstable" in text.get_text() for text in figure.legends[0].get_texts())


def changed_vehicle(folder: Path, **changes: Any) -> Path:
    """That of PX4, with other parts."""
    path = folder / "vehicle.yaml"
    data = yaml.safe_load((configs_folder() / "vehicles" / "px4.yaml").read_text("utf-8"))
    path.write_text(yaml.safe_dump(data | changes), "utf-8")
    return path


def test_what_the_identification_doubted_is_told_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    doubt = "down: the model explains only 33 %: do not tune by it"
    vehicle = changed_vehicle(tmp_path, evidence={"remarks": [doubt]})
    assert tune_follower(TuneOptions(str(vehicle), out=tmp_path)) == 0
    assert doubt in " ".join(capsys.readouterr().out.split())
    assert doubt in (tmp_path / "tune" / "tuning.html").read_text("utf-8")


@pytest.mark.parametrize(
    ("overrides", "remark"),
    [
        (("servo.mode=watch",), "servo.mode is watch: it uses azimuth alone"),
        (("servo.mode=overhead",), "overhead: these are the loops of chase; its own are not tuned"),
        (("servo.hold_height=true",), "servo.hold_height is set: the elevation loop does nothing"),
    ],
)
def test_what_the_loops_of_chasing_do_not_say_of_the_settings_is_told(
    overrides: tuple[str, ...], remark: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert tune_follower(TuneOptions("px4", overrides=overrides, out=tmp_path)) == 0
    assert remark in " ".join(capsys.readouterr().out.split())
    assert remark in (tmp_path / "tune" / "tuning.html").read_text("utf-8")


def test_a_vehicle_that_no_gains_can_hold_is_reported_as_that(tmp_path: Path) -> None:
    slow = yaml.safe_load((configs_folder() / "vehicles" / "px4.yaml").read_text("utf-8"))
    slow["vehicle"]["yaw_rate"]["dead_time_s"] = 20
    vehicle = changed_vehicle(tmp_path, vehicle=slow["vehicle"])
    assert tune_follower(TuneOptions(str(vehicle), out=tmp_path)) == 0
    assert "unstable" in (tmp_path / "tune" / "tuning.html").read_text("utf-8")


@pytest.mark.parametrize("size_m", [-1, 0, float("nan"), 1e6])
def test_a_target_of_no_size_is_refused(tmp_path: Path, size_m: float) -> None:
    with pytest.raises(SettingsError, match=r"target\.size_m"):
        load_vehicle(changed_vehicle(tmp_path, target={"size_m": size_m}))


def test_the_plots_go_by_the_ms_that_is_wanted_and_say_what_they_leave_out(tmp_path: Path) -> None:
    what_ifs = tuple(f"gain={factor}" for factor in (0.5, 0.6, 0.7, 0.8, 0.9))
    options = TuneOptions("px4", max_sensitivity=2.0, what_ifs=what_ifs, out=tmp_path)
    assert tune_follower(options) == 0
    assert "The plots show the first 4 of them." in (tmp_path / "tune" / "tuning.html").read_text()
    settings, vehicle = load_settings(), find_vehicle("px4")
    here = conditions_of(settings, vehicle, -20.0)
    found = analyse(settings, vehicle.model(), here, options.goals())
    (panel,) = nyquist(found[0]).axes
    (disc,) = panel.patches
    assert disc.radius == 1 / 2.0


@pytest.mark.parametrize(
    ("given", "overrides", "expected"),
    [
        (None, (), 0.0),
        (None, ("camera.pitch_deg=-14",), -14.0),
        (None, ("camera.pitch_deg=-14", "servo.elevation_deg=0"), 0.0),
        (None, ("camera.pitch_deg=-90",), -80.0),
        (-30.0, ("servo.elevation_deg=-25",), -30.0),
    ],
)
def test_the_loops_are_analysed_at_the_elevation_at_which_the_target_is_kept(
    given: float | None, overrides: tuple[str, ...], expected: float
) -> None:
    settings = load_settings(None, None, overrides)
    assert elevation_deg(TuneOptions("px4", elevation_deg=given), settings) == expected


def test_on_80_columns_nothing_of_the_tables_is_cut(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    what_ifs = ("dead_time=0.25", "dead_time=0.3,stamp_error=0.08,camera_rate=15,gain=1.25")
    assert tune_follower(TuneOptions("px4", what_ifs=what_ifs, out=tmp_path)) == 0
    out = capsys.readouterr().out
    assert "…" not in out
    assert {"azimuth", "elevation", "dead_time=0.25", "0.148"} <= set(out.split())
