"""Packages that add links and follow modes; and a flight whose tracker fails."""

import pickle
from contextlib import closing
from dataclasses import fields
from html import escape
from pathlib import Path
from typing import Any

import pytest
from csv_rows import rows_of
from plugin_packages import Site, warnings_in
from small_scenario import NEAR_CAR

from follower.apps.command_settings import command_settings
from follower.apps.inspect import inspect_flight
from follower.links.link import Link
from follower.links.open import open_link
from follower.settings.link import LinkSettings
from follower.settings.settings import load_settings
from follower.simulation.options import SimulationOptions, VisionSource
from follower.simulation.run import SimulationResult, simulate
from follower.ui.cockpit.publisher import setting_list
from follower.ui.ground_station.parameters import NONE, by_name
from follower_control.common.strict_config import SettingsError
from follower_control.common.transport import MemoryTransport
from follower_control.servo.settings import FollowMode
from follower_sim.scenario.scenario import Criteria
from follower_vision.clock import MonotonicClock
from follower_vision.plugins import PluginError

LINK = """
from follower.links.pymavlink_link import MavlinkLink

class Twice(MavlinkLink):
    kind = "twice"
    def _send_setpoint(self, setpoint, vehicle):
        for _ in range(2):
            super()._send_setpoint(setpoint, vehicle)

make = Twice
"""


def test_a_link_of_a_package_is_opened_by_its_name(site: Site) -> None:
    site.add("follower-radio", "links", "radio", LINK)
    settings = command_settings(link="radio")
    assert site.imported() == []
    wire, autopilot = MemoryTransport.pair()
    with (
        closing(open_link(wire, settings.link, MonotonicClock(), 0)) as link,
        closing(autopilot),
    ):
        assert isinstance(link, Link)
        assert link.kind == "twice"
    with pytest.raises(SettingsError, match=r"--link morse: choose pymavlink or mavsdk or radio"):
        command_settings(link="morse")
    with pytest.raises(SettingsError, match=r"link: kind: there is no 'morse'; there are .*radio"):
        load_settings(overrides=["link.kind=morse"])


def test_a_link_that_cannot_be_used_is_named(site: Site) -> None:
    site.add("follower-mute", "links", "mute", "def make(*parts): return 3\n")
    settings = LinkSettings(kind="mute")
    with pytest.raises(PluginError, match=r"the link 'mute' of follower-mute 1.0 is none: it has"):
        open_link(MemoryTransport.pair()[0], settings, MonotonicClock(), 0)


HOARSE = """
from follower.links.pymavlink_link import MavlinkLink

class Hoarse(MavlinkLink):
    sent = 0
    def _send_setpoint(self, setpoint, vehicle):
        self.sent += 1
        if self.sent > 200:
            raise RuntimeError("the radio is gone")
        super()._send_setpoint(setpoint, vehicle)

make = Hoarse
"""


@pytest.mark.slow
def test_a_link_that_fails_in_flight_is_named_and_the_flight_goes_on_to_its_end(
    site: Site, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    site.add("follower-hoarse", "links", "hoarse", HOARSE)
    rows = flown(tmp_path, "link.kind=hoarse", vision=VisionSource.TRUTH)
    assert float(rows[-1]["time"]) > 13.0
    assert rows[-1]["state"] == "released"
    (line,) = warnings_in(caplog)
    assert line == (
        "the link 'hoarse' of follower-hoarse 1.0 fails, and it is silent: "
        "RuntimeError: the radio is gone"
    )


EXAMPLE = Path(__file__).parents[2] / "examples/follower-template-mode/follower_template_mode.py"
LEASH = EXAMPLE.read_text("utf-8")


def breaking(at_s: float) -> str:
    """Return a leash that breaks in flight."""
    return LEASH.replace(
        "    chased =",
        f"    if step.estimate.time_s > {at_s}:\n"
        '        raise ZeroDivisionError("the leash broke")\n    chased =',
    )


def flight(folder: Path, *overrides: str, record: bool = False, **options: Any) -> SimulationResult:
    """Fly beside the car."""
    scenario = folder / "near.yaml"
    scenario.write_text(NEAR_CAR, "utf-8")
    return simulate(
        SimulationOptions(
            str(scenario),
            lockstep=True,
            overrides=overrides,
            out=folder / "runs",
            video=False,
            record=record,
            **options,
        )
    )


def flown(folder: Path, *overrides: str, **options: Any) -> list[dict[str, str]]:
    """Do the same; return the setpoints, a row a control step."""
    return rows_of(flight(folder, *overrides, **options).folder / "setpoints.csv")


@pytest.mark.slow
def test_a_follow_mode_of_a_package_flies(
    site: Site, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    site.add("follower-leash", "follow_modes", "leash", LEASH)
    rows = flown(tmp_path, "servo.mode=leash", vision=VisionSource.TRUTH)
    forward = [float(row["forward_m_s"]) for row in rows if row["state"] == "following"]
    assert len(forward) > 100
    assert min(forward) == 0.0
    assert warnings_in(caplog) == []
    mode = FollowMode("leash")
    assert mode not in list(FollowMode)
    assert load_settings(overrides=["servo.mode=leash"]).servo.mode is mode
    assert "mode: leash\n" in load_settings(overrides=["servo.mode=leash"]).to_yaml()
    assert pickle.loads(pickle.dumps(mode)) is mode


@pytest.mark.slow
def test_a_follow_mode_that_fails_in_flight_holds(
    site: Site, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    site.add("follower-frayed", "follow_modes", "frayed", breaking(10.0))
    rows = flown(tmp_path, "servo.mode=frayed", vision=VisionSource.TRUTH)
    last = [row for row in rows if row["state"] == "following"][-1]
    assert [float(last[name]) for name in ("forward_m_s", "right_m_s", "down_m_s")] == [0, 0, 0]
    (line,) = warnings_in(caplog)
    assert line == (
        "the follow mode 'frayed' of follower-frayed 1.0 fails, and the vehicle holds: "
        "ZeroDivisionError: the leash broke"
    )


@pytest.mark.slow
def test_each_flight_in_which_a_follow_mode_fails_has_failed_and_says_so(
    site: Site, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site.add("follower-worn", "follow_modes", "worn", breaking(13.5))
    line = (
        "The follow mode 'worn' of follower-worn 1.0 fails, and the vehicle holds: "
        "ZeroDivisionError: the leash broke"
    )
    lenient = tuple(f"expect.{one.name}=null" for one in fields(Criteria))
    for _ in range(2):
        result = flight(tmp_path, "servo.mode=worn", vision=VisionSource.TRUTH, scene=lenient)
        assert (result.end.sentence, result.exit_code) == ("The pursuit failed", 1)
        assert line in " ".join(capsys.readouterr().out.split())
        assert escape(line) in (result.folder / "report.html").read_text("utf-8")


@pytest.mark.slow
def test_a_recording_says_which_part_failed(
    site: Site, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site.add("follower-stray", "follow_modes", "stray", "def make(servo, step): return None\n")
    result = flight(tmp_path, "servo.mode=stray", "detector=null", record=True)
    report = inspect_flight(result.folder)
    line = "The follow mode 'stray' of follower-stray 1.0 fails, and the vehicle holds"
    assert line in " ".join(capsys.readouterr().out.split())
    assert escape(line) in report.read_text("utf-8")


def test_a_follow_mode_of_a_package_is_shown_to_operators(site: Site) -> None:
    site.add("follower-rope", "follow_modes", "rope", LEASH)
    settings = load_settings(overrides=["servo.mode=rope"])
    (mode,) = [one for one in setting_list(settings) if one["key"] == "servo.mode"]
    assert (mode["value"], mode["choices"]) == ("rope", [*FollowMode, "rope"])
    assert by_name()["SRV_MODE"].number(settings) == NONE, "it stands for no number"


def test_a_follow_mode_that_cannot_be_used_is_named_and_refused_in_one_line(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    site.add("follower-torn", "follow_modes", "torn", "import no_such_module\n")
    said = r"servo.mode: the follow mode 'torn' of follower-torn 1.0 cannot be imported: Module"
    with pytest.raises(SettingsError, match=said):
        load_settings(overrides=["servo.mode=torn"])
    assert warnings_in(caplog) == []


@pytest.mark.parametrize("mistyped", ["twin", "null", "3", "[chase]"])
def test_a_mistyped_follow_mode_is_told_all_there_are(site: Site, mistyped: str) -> None:
    site.add("follower-twine", "follow_modes", "twine", LEASH)
    said = r"servo\.mode: there is no follow mode .*; there are chase, .*overhead, twine$"
    with pytest.raises(SettingsError, match=said):
        load_settings(overrides=[f"servo.mode={mistyped}"])
    assert site.imported() == []


def test_a_package_with_a_follow_mode_of_our_name_is_named(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    site.add("follower-double", "follow_modes", "chase", LEASH)
    assert load_settings(overrides=["servo.mode=chase"]).servo.mode is FollowMode.CHASE
    (line,) = warnings_in(caplog)
    assert line.startswith("drone-target-follower and follower-double 1.0 each have a follow mode")
