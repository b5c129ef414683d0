"""Faults in simulated flights: some of the matrix, and whether its judge can say no.

The whole matrix, both autopilots, is flown by `follower faults`, or here with FOLLOWER_FAULTS=all.
"""

import math
import os
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from pydantic import TypeAdapter
from pymavlink.dialects.v20 import common as mavlink
from rich.console import Console

from follower.flight.log import ControlRecord
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower.settings.settings import load_settings
from follower.settings.supervisor import ReleaseAction
from follower.simulation.fault_tests.command import _fly_random, faults_command
from follower.simulation.fault_tests.random_flight import fly_random
from follower.simulation.fault_tests.results import FaultResult, Results, Tally
from follower.simulation.fault_tests.run_fault import fly_fault
from follower.simulation.faults.fault import (
    ExpectedOutcome,
    Fault,
    FaultKind,
    FaultSchedule,
    FaultSetup,
    PlannedFault,
    catalogue,
    fault_named,
)
from follower.simulation.faults.in_simulation import describe_verdict
from follower.simulation.faults.injector import AutopilotFaults
from follower.simulation.faults.judge import FaultCase, FaultMetrics, FaultVerdict, judge
from follower.simulation.faults.setpoint_rules import (
    envelope_failures,
    heartbeat_failures,
    input_failures,
    pilot_failures,
)
from follower.simulation.faults.wire_tap import FlightEvidence, TrueMotion, WireSetpoint, WireTap
from follower.simulation.options import SimulationOptions
from follower.simulation.run import simulate
from follower.workers import engine_for
from follower_control.common.strict_config import SettingsError
from follower_control.common.transport import MemoryTransport
from follower_control.envelope.settings import EnvelopeSettings
from follower_control.vehicle.setpoint import HOLD
from follower_control.vehicle.state import VehicleState
from follower_sim.autopilot.autopilot import SimAutopilot
from follower_sim.autopilot.firmware import PX4
from follower_sim.kinematics import BodyState
from follower_vision.clock import SimulatedClock

CHOSEN = (
    ("vision-hangs", "ardupilot"),
    ("position-frozen", "px4"),
    ("loss-30%", "ardupilot"),
    ("link-down-5s", "px4"),
    ("unsigned", "px4"),
    ("pilot-while-searching", "ardupilot"),
    ("release-land", "ardupilot"),
)
EVERYTHING = tuple(
    (fault.name, flavour) for fault in catalogue() if fault.lockstep for flavour in fault.flavours
)
CASES = EVERYTHING if os.environ.get("FOLLOWER_FAULTS") == "all" else CHOSEN


@pytest.mark.slow
@pytest.mark.parametrize(("name", "flavour"), CASES)
def test_what_must_happen_happens(name: str, flavour: str) -> None:
    verdict = fly_fault(fault_named(name), FaultSetup(flavour))
    assert verdict.failures == ()
    assert verdict.figures.setpoints > 0


@pytest.mark.slow
def test_a_promise_that_is_not_kept_is_noticed() -> None:
    fault = replace(
        fault_named("frames-stop"), outcome=ExpectedOutcome.FOLLOWS_ON, rest_within_s=0.1
    )
    failures = "; ".join(fly_fault(fault, FaultSetup("ardupilot")).failures)
    assert "holding (frames stale)" in failures
    assert "standing still" in failures
    assert "does not follow again" in failures


def test_names_are_unique_and_every_kind_is_used() -> None:
    names = [fault.name for fault in catalogue()]
    assert len(names) == len(set(names))
    used = {action.kind for fault in catalogue() for action in fault.actions}
    assert used == set(FaultKind)


def test_a_mistyped_key_of_the_catalogue_is_refused() -> None:
    given = {"name": "x", "group": "y", "must": "z", "outcome": "follows on"}
    actions = [{"kind": "vision dies"}]
    faults = TypeAdapter(Fault)
    assert faults.validate_python({**given, "actions": actions}).name == "x"
    for wrong in ({"actions": actions, "hold_within": 1}, {"actions": [{**actions[0], "for": 2}]}):
        with pytest.raises(ValueError, match="Unexpected keyword"):
            faults.validate_python({**given, **wrong})


def test_each_release_has_its_time() -> None:
    for fault in catalogue():
        if fault.outcome is ExpectedOutcome.RELEASED and "failsafe" not in fault.name:
            assert fault.hold_within_s is not None


def test_a_release_is_judged_by_mode_and_silence() -> None:
    def failures(mode: str, *times_s: float) -> str:
        evidence = FlightEvidence("px4")
        evidence.motion = [TrueMotion(12.0, (0, 0, -5), (0, 0, 0), mode, mode == "OFFBOARD", True)]
        evidence.setpoints = sent(*((time_s, 0.0) for time_s in times_s))
        controls = [released_at(1.5), released_at(12.0)]
        planned = PlannedFault.of(fault_named("release-land"))
        limits = EnvelopeSettings()
        return "; ".join(
            judge(FaultCase(planned, 1.0, 11.0, evidence, controls, (), limits)).failures
        )

    assert "mode" not in failures("LAND", 1.0, 9.9)
    assert "in LAND" in failures("OFFBOARD", 1.0, 9.9)
    assert "9.5 s on, not within 9.0 s" in failures("LAND", 1.0, 10.5)
    assert "setpoint" not in failures("LAND", 1.0, 9.9)


def released_at(time_s: float) -> ControlRecord:
    released = SupervisorState.RELEASED, SupervisorReason.CONSENT_WITHDRAWN
    return ControlRecord(
        *(time_s, 0.0, 0.0, *released, None, None, VehicleState(), HOLD, HOLD, ()), sent=True
    )


def test_what_a_fault_sets_can_be_set_and_names_a_mode_for_each_autopilot() -> None:
    for fault in catalogue():
        load_settings(overrides=fault.settings)
        assert set(fault.ends_in) in (set(), set(fault.flavours))
        assert bool(fault.ends_in) is (fault.outcome is ExpectedOutcome.RELEASED_IN_MODE)
    actions = {load_settings(overrides=fault.settings).release.action for fault in catalogue()}
    assert actions == set(ReleaseAction)


def test_mavsdk_flies_in_real_time_alone_and_both_links_fly_nearly_the_whole_catalogue() -> None:
    for fault in catalogue():
        assert not fault.flies(FaultSetup("px4", "mavsdk"))
        for link in fault.links:
            realtime = link == "mavsdk" or not fault.lockstep
            assert fault.flies(FaultSetup(fault.flavours[0], link, realtime))
    alone = {fault.name for fault in catalogue() if len(fault.links) < 2}
    assert alone == {
        "control-stalls-2s",  # the autopilot's time-out acts, where nobody watches the stream
        "control-stalls-into-failsafe",
        "control-stalls-into-hold",  # mavsdk's watchdog does
        "cpu-starved",
        "cpu-starved-0.2s",  # later steps are a stall to that watchdog
    }
    assert not fault_named("pilot-while-ready").flies(FaultSetup("ardupilot"))


@pytest.mark.slow
def test_an_autopilot_in_its_own_failsafe_is_not_called_back() -> None:
    fault = fault_named("control-stalls-into-failsafe")
    verdict = fly_fault(fault, FaultSetup("px4"))
    assert verdict.failures == ()
    assert verdict.figures.hold_s is None, "a hold after the stall would restart PX4's OFFBOARD"


@pytest.mark.parametrize(
    ("text", "at_s", "for_s"),
    [("frames-stop", None, math.inf), ("loss-5%@12", 12.0, 4.0), ("garbage@3.5:7", 3.5, 7.0)],
)
def test_a_fault_is_planned_by_its_name_time_and_duration(
    text: str, at_s: float | None, for_s: float
) -> None:
    planned = PlannedFault.parse(text)
    assert (planned.at_s, planned.for_s) == (at_s, for_s)
    assert PlannedFault.parse(str(planned)) == planned


def test_a_fault_after_the_end_is_refused(tmp_path: Path) -> None:
    late = SimulationOptions("winding", lockstep=True, out=tmp_path, faults=("frames-black@78:2",))
    said = r"--fault frames-black@78:2: the flight ends at 78 s; .* or --scene duration_s=83"
    with pytest.raises(SettingsError, match=said):
        simulate(late)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "text", ["nothing-like-it", "garbage@soon", "garbage@-1", "", "garbage@1:2:3", "garbage@9:0"]
)
def test_what_is_no_fault_is_refused(text: str) -> None:
    with pytest.raises(SettingsError, match="--fault"):
        PlannedFault.parse(text)


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("process-killed", {}, "in real time"),
        ("pilot-while-ready", {"autopilot": "ardupilot"}, "px4"),
        ("cpu-starved", {"link": "mavsdk"}, "pymavlink"),
    ],
)
def test_a_fault_that_is_asked_for_and_cannot_be_flown_is_no_success(
    tmp_path: Path, name: str, options: dict[str, str], said: str
) -> None:
    with pytest.raises(SettingsError, match=f"{name} cannot come about so, only with: {said};"):
        faults_command([name], out=tmp_path, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("how", [{"random": 3}, {"only": 0}])
def test_names_beside_random_flights_are_refused(tmp_path: Path, how: dict[str, int]) -> None:
    with pytest.raises(SettingsError, match="frames-black: random flights draw faults"):
        faults_command(["frames-black"], out=tmp_path, **how)  # type: ignore[arg-type]


def test_a_fault_begins_by_state_or_time_and_ends() -> None:
    by_state = FaultSchedule([PlannedFault.of(fault_named("link-down-0.2s"))])
    by_state.observe(1.0, SupervisorState.READY, 50.0)
    assert by_state.active(FaultKind.LINK_DOWN, 1.0) is None
    by_state.observe(2.0, SupervisorState.FOLLOWING, 9.0)
    assert by_state.active(FaultKind.LINK_DOWN, 2.0) is not None
    assert by_state.active(FaultKind.LINK_DOWN, 2.3) is None
    assert not by_state.is_over(2.3)
    by_time = FaultSchedule([PlannedFault.parse("link-down-0.2s@7:1")])
    by_time.observe(6.9, SupervisorState.FOLLOWING, 9.0)
    assert by_time.active(FaultKind.LINK_DOWN, 6.9) is None
    by_time.observe(7.0, SupervisorState.IDLE, 0.0)
    assert by_time.end_of(FaultKind.LINK_DOWN, 7.5) == 8.0


def test_what_happens_at_an_instant_happens_again_where_it_is_asked_for_twice() -> None:
    texts = ("pilot-while-following@1", "pilot-while-following@5")
    schedule = FaultSchedule(map(PlannedFault.parse, texts))
    start = BodyState(0.0, (0.0, 0.0, -8.0))
    autopilot = SimAutopilot("ardupilot", MemoryTransport.pair()[1], start)
    faults, modes = AutopilotFaults(autopilot, "ardupilot", schedule), []
    for time_s in (1.0, 1.2, 4.0, 5.0, 5.2, 6.0):
        autopilot.switch_mode("GUIDED")
        schedule.observe(time_s, SupervisorState.FOLLOWING, 9.0)
        faults.apply(time_s)
        modes.append(autopilot.mode)
    assert modes == ["GUIDED", "LOITER", "GUIDED", "GUIDED", "LOITER", "GUIDED"]


def test_a_sentence_is_told_as_kept_only_where_it_was_judged() -> None:
    def said(text: str, alone: bool) -> str:
        evidence = FlightEvidence("px4")
        evidence.motion = [TrueMotion(12.0, (0, 0, -5), (0, 0, 0), "LAND", False, True)]
        evidence.setpoints = sent((1.05, 0.0), (9.9, 0.0))
        controls = [released_at(1.05), released_at(12.0)]
        planned = PlannedFault.parse(text)
        return describe_verdict(
            judge(FaultCase(planned, 1.0, 11.0, evidence, controls, (), EnvelopeSettings(), alone))
        )

    must = fault_named("release-land").must
    assert f"as it must be. ({must})" in said("release-land", alone=True)
    chosen = said("release-land@1:5", alone=False)
    assert chosen.startswith("Fault release-land@1:5: what always holds was kept. (Its own")
    assert must not in chosen


def test_the_fence_is_about_where_the_vehicle_stood() -> None:
    def failures(start_m: float, end_m: float, limits: EnvelopeSettings) -> str:
        evidence = FlightEvidence("px4")
        evidence.motion = [
            TrueMotion(time_s, (north_m, 0, -5), (0, 0, 0), "OFFBOARD", True, True)
            for time_s, north_m in ((0.0, start_m), (12.0, end_m))
        ]
        planned, controls = PlannedFault.parse("garbage"), [released_at(1.5)]
        return "; ".join(
            judge(FaultCase(planned, 1.0, 5.0, evidence, controls, (), limits)).failures
        )

    circle = EnvelopeSettings(fence_radius_m=50.0)
    polygon = EnvelopeSettings(fence_m=((-10, -10), (-10, 10), (50, 10), (50, -10)))
    for limits in (circle, polygon):
        assert "it flies" not in failures(-200.0, -160.0, limits)
    assert "it flies 80 m away" in failures(-40.0, 40.0, circle)
    assert "it flies 30 m out of the fence" in failures(-40.0, 40.0, polygon)


def test_what_is_held_may_not_fly_faster_again() -> None:
    controls = [released_at(1.0), released_at(12.0)]
    braking = sent((1.02, 4.0), (1.2, 3.5), (2.0, 1.0), (3.0, 0.0))
    assert list(input_failures(controls, braking)) == []
    (failure,) = input_failures(controls, sent((1.6, 1.0), (2.0, 1.5), (3.0, 4.0), (5.9, 0.0)))
    assert failure == "2.00 s: 1.50 m/s after a hold that was at 1.00 m/s"
    (failure,) = input_failures(controls, sent((1.6, 1.0), (6.1, 1.0)))
    assert "still 1.00 m/s" in failure


def sent(*values: tuple[float, float]) -> list[WireSetpoint]:
    return [WireSetpoint(time_s, 8, 0x5C7, (speed, 0.0, 0.0, 0.0)) for time_s, speed in values]


def test_the_watcher_refuses_what_is_outside_the_envelope() -> None:
    limits = EnvelopeSettings()
    assert list(envelope_failures(sent((0.0, 1.0), (0.02, 1.05)), limits)) == []
    assert list(envelope_failures(sent((0.0, 10.1)), limits))
    assert list(envelope_failures(sent((0.0, math.nan)), limits))
    assert list(envelope_failures(sent((0.0, 1.0), (0.02, 1.5)), limits))
    assert list(envelope_failures([replace(sent((0.0, 1.0))[0], frame=9)], limits))


def handed_over() -> FlightEvidence:
    evidence = FlightEvidence("px4")
    for step in range(200):
        obeys = step < 100
        mode = "OFFBOARD" if obeys else "POSCTL"
        evidence.motion.append(TrueMotion(0.01 * step, (0, 0, -5), (0, 0, 0), mode, obeys, True))
    evidence.mode_heartbeats = [(0.5, True), (1.2, False)]
    return evidence


def test_the_watcher_sees_set_points_after_the_pilot_took_over() -> None:
    evidence = handed_over()
    evidence.setpoints = sent((1.0, 1.0), (1.25, 1.0))
    assert list(pilot_failures(evidence)) == []
    evidence.setpoints = sent((1.35, 1.0))
    assert "a velocity after the mode was left" in next(pilot_failures(evidence))
    evidence.setpoints = sent((1.35, 0.0))
    assert "another mode" in next(pilot_failures(evidence))


def test_the_heartbeats_of_a_vehicle_of_any_number_count() -> None:
    """PX4's second program is vehicle 2."""
    codec = mavlink.MAVLink(None, 2, 1)
    offboard = PX4.modes["OFFBOARD"].custom_mode
    ours, theirs = MemoryTransport.pair()
    tap = WireTap(ours, SimulatedClock(1.0))
    beat = mavlink.MAVLink_heartbeat_message(2, 12, 128, offboard, 4, 3)
    theirs.send(beat.pack(codec))
    tap.receive()
    for vehicle_id, heard in ((2, [(1.0, True)]), (1, [])):
        evidence = FlightEvidence("px4")
        evidence.read(tap.sent, tap.received, vehicle_id)
        assert evidence.mode_heartbeats == heard


def test_heartbeats_alone_tell_that_a_velocity_came_too_late() -> None:
    evidence = handed_over()
    evidence.setpoints = sent((1.25, 1.0), (1.35, 0.0))
    assert list(heartbeat_failures(evidence)) == []
    evidence.setpoints = sent((1.35, 1.0))
    assert "1.35 s: a velocity in another mode" in next(heartbeat_failures(evidence))


@pytest.mark.slow
def test_random_flights_keep_every_rule_and_are_the_same_again() -> None:
    flights = range(4)  # thousands by `follower faults --random`
    results = [fly_random((2026, number)) for number in flights]
    assert [result.failure for result in results] == [""] * len(flights)
    assert sum(result.engaged_steps for result in results) > 500
    assert sum(sum(result.faults.values()) for result in results) > 20
    assert fly_random((2026, 0)) == results[0]


@pytest.mark.slow
def test_random_flights_in_two_processes_come_to_the_sums_of_one(tmp_path: Path) -> None:
    for workers in (0, 2):
        with closing(engine_for(workers, None)) as engine:
            _fly_random(Console(quiet=True), engine, 3, 5, tmp_path / f"{workers}.json")
    here, spread = (replace(Tally.load(tmp_path / f"{n}.json"), busy_s=0.0) for n in (0, 2))
    assert here.flights == 3
    assert spread == here


@pytest.mark.slow
def test_a_campaign_goes_on_where_it_was(tmp_path: Path) -> None:
    path = tmp_path / "random.json"
    tally = Tally.load(path, 3)
    tally.add(fly_random((3, 0)), 1.0)
    tally.save(path)
    again = Tally.load(path, 3)
    assert again == tally
    assert again.flights == 1
    assert again.minutes == pytest.approx(tally.steps / 3000)
    with pytest.raises(SettingsError, match=r"random.json: 1 flight of seed 3 .* --seed 3"):
        Tally.load(path, 4)


def test_results_are_kept_and_renewed(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    verdict = FaultVerdict("vision-dies", "hold", ("late",), FaultMetrics(hold_s=0.5), "released")
    Results(path).add(FaultResult("px4", "pymavlink", False, verdict))
    Results(path).add(FaultResult("px4", "mavsdk", True, verdict))
    Results(path).add(FaultResult("px4", "pymavlink", False, replace(verdict, failures=())))
    kept = list(Results(path))
    assert len(kept) == 2
    assert kept[0].verdict.passed
    assert not kept[1].verdict.passed
    assert kept[1].verdict == verdict


@pytest.mark.parametrize("content", ["{", "[1]", '{"flights": "many"}'])
def test_a_file_of_something_else_is_refused_in_one_line(tmp_path: Path, content: str) -> None:
    path = tmp_path / "kept.json"
    path.write_text(content)
    for read in (Results, Tally.load):
        with pytest.raises(SettingsError, match=r"kept.json: these are no results"):
            read(path)
