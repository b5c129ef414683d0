"""The identification pattern: where it leads, who may end it, and that its recording tells."""

import math
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from follower.apps.main import app
from follower.apps.replay.replay import Replay, replay_settings
from follower.flight.log import FlightLog
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower.recording import FlightConfig, Recorder, open_flight
from follower.recording.mcap_writer import McapLog
from follower.settings.settings import Settings, configs_folder, load_settings
from follower.tuning.excite import run as run_module
from follower.tuning.excite.pattern import ExcitationSettings, Pattern, PatternKind
from follower.tuning.excite.run import ExcitationFlight, fly_simulated, run_of
from follower.tuning.excite.stage import ExcitationStage, excitation_settings
from follower.tuning.identify.readers import VehicleAxis
from follower.tuning.identify.run import identification, read_recording
from follower.tuning.tune.run import find_vehicle
from follower_control.vehicle.setpoint import HOLD
from follower_control.vehicle.state import Attitude, LocalPosition, VehicleState
from follower_vision.clock import SimulatedClock

SETTINGS = excitation_settings(load_settings(base={"autonomy": "full"}))
SHORT = ExcitationSettings(forward_m_s=1.5, right_m_s=0, vertical_m_s=0, yaw_deg_s=0, hold_s=2.5)


def vehicle(now_s: float, **changes: object) -> VehicleState:
    attitude = Attitude(0.0, 0.0, 0.01 * now_s, 0.0, 0.0, 0.0, now_s)
    position = LocalPosition(0.01 * now_s, 0.0, -10.0, 0.0, 0.0, 0.0, now_s)
    state = VehicleState(attitude, position, "OFFBOARD", True, True, False, now_s, entries=1)
    return replace(state, **changes)


def step(stage: ExcitationStage, now_s: float, state: VehicleState, told: bool = True):
    attitudes = (state.attitude,) if told and state.attitude is not None else ()
    return stage.step(now_s, None, state, attitudes)


def stage_of(settings=SETTINGS, excitation=SHORT) -> ExcitationStage:
    camera = settings.camera.model(640, 480)
    return ExcitationStage(settings, Pattern(excitation), camera, FlightLog())


@pytest.mark.parametrize("kind", PatternKind)
def test_a_pattern_asks_for_no_more_than_is_set_and_ends_where_it_began(kind: PatternKind) -> None:
    settings = ExcitationSettings(kind)
    pattern = Pattern(settings)
    times = np.arange(0.0, pattern.length_s, 0.01)
    asked = np.array([pattern.setpoint(float(t)).values for t in times])
    most = (2.0, 2.0, 0.8, math.radians(30.0))
    shares = np.abs(asked).max(axis=0) / most
    assert shares.max() <= 1.0 + 1e-9
    assert shares.min() >= 0.8
    # Where it has led to, over how far it was away: back home but for rounding.
    assert np.abs(asked.sum(axis=0) * 0.01) == pytest.approx(0.0, abs=0.15)
    assert (np.count_nonzero(asked, axis=1) <= 1).all()
    assert pattern.setpoint(-1.0) == pattern.setpoint(pattern.length_s + 1.0) == HOLD


def test_nothing_moves_before_it_is_ready_and_the_pilot_chose_the_mode() -> None:
    stage = stage_of()
    for i in range(20):
        record = step(stage, 0.02 * i, vehicle(0.02 * i))
    assert record.state is SupervisorState.IDLE
    stage.ready = True
    for i in range(20, 40):
        record = step(stage, 0.02 * i, vehicle(0.02 * i, obeys_setpoints=False, mode="POSCTL"))
    assert record.state is SupervisorState.READY
    assert record.allowed == HOLD


def test_the_pilot_ends_it_by_the_mode() -> None:
    stage = stage_of()
    stage.ready = True
    for i in range(200):
        record = step(stage, 0.02 * i, vehicle(0.02 * i))
    assert record.state is SupervisorState.FOLLOWING
    assert record.allowed.forward_m_s > 0.3
    record = step(stage, 4.0, vehicle(4.0, obeys_setpoints=False, mode="POSCTL"))
    assert (record.state, record.reason) == (
        SupervisorState.RELEASED,
        SupervisorReason.PILOT_TOOK_OVER,
    )
    assert not record.sent


def test_stale_telemetry_holds_and_the_pattern_goes_on_where_it_was() -> None:
    stage = stage_of()
    stage.ready = True
    for i in range(200):
        step(stage, 0.02 * i, vehicle(0.02 * i))
    flown_s = stage.elapsed_s
    for i in range(200, 240):
        record = step(stage, 0.02 * i, vehicle(3.98, heartbeat_s=0.02 * i), told=False)
    assert record.state is SupervisorState.HOLDING
    assert stage.elapsed_s == pytest.approx(flown_s, abs=0.6)
    for i in range(240, 260):
        record = step(stage, 0.02 * i, vehicle(0.02 * i))
    assert record.state is SupervisorState.FOLLOWING
    assert stage.elapsed_s < flown_s + 1.1


def fly(
    folder: Path,
    settings: Settings = SETTINGS,
    excitation: ExcitationSettings = SHORT,
    flavour: str = "ardupilot",
) -> ExcitationFlight:
    clock = SimulatedClock()
    camera = settings.camera.model(640, 480)
    config = FlightConfig.of("simulated", settings, run=run_of(excitation), camera=camera)
    with Recorder(folder, config, clock, settings.recorder, threaded=False) as recorder:
        return fly_simulated(flavour, settings, excitation, recorder, clock, lambda _: None)


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ExcitationFlight]:
    folder = tmp_path_factory.mktemp("flight")
    flight = fly(folder)
    return folder, flight


@pytest.mark.slow
def test_a_simulated_flight_keeps_the_envelope_and_ends_in_a_hold(
    flown: tuple[Path, ExcitationFlight],
) -> None:
    _, flight = flown
    assert flight.complete
    assert flight.finished
    controls = flight.log.controls
    assert controls[-1].state is SupervisorState.RELEASED
    assert controls[-1].reason is SupervisorReason.STOP_REQUESTED
    sent = [record for record in controls if record.sent]
    assert sent[-1].allowed.forward_m_s == pytest.approx(0.0, abs=1e-6)
    speeds = np.array([record.allowed.forward_m_s for record in sent])
    assert np.abs(np.diff(speeds)).max() <= 3.0 * 0.0201
    position = controls[-1].vehicle.position
    assert math.hypot(position.north_m, position.east_m) < 2.0


@pytest.mark.slow
def test_its_replay_is_the_same_to_the_last_bit(flown: tuple[Path, ExcitationFlight]) -> None:
    folder, flight = flown
    recorded = open_flight(folder)
    again = Replay(recorded, replay_settings(recorded), tracks_recorded=True).run()
    assert [r.allowed for r in again.controls] == [r.allowed for r in flight.log.controls]
    assert [r.state for r in again.controls] == [r.state for r in flight.log.controls]


@pytest.mark.slow
def test_its_recording_tells_how_the_vehicle_answers(
    flown: tuple[Path, ExcitationFlight],
) -> None:
    folder, _ = flown
    found = identification([read_recording(folder)])
    assert set(found.fits) == {VehicleAxis.FORWARD}
    fit = found.fits[VehicleAxis.FORWARD]
    assert fit.held_out_fit > 0.9
    assert fit.model.gain == pytest.approx(1.0, abs=0.06)
    assert 0.03 < fit.model.dead_time_s < 0.4
    assert any("down: nothing moved this axis" in remark for remark in found.remarks)


@pytest.mark.slow
def test_what_was_asked_for_is_seen_however_many_setpoints_it_took(tmp_path: Path) -> None:
    """Each of many differs little from the one before."""
    fly(tmp_path, SETTINGS.model_copy(update={"control_rate_hz": 250.0}))
    assert VehicleAxis.FORWARD in read_recording(tmp_path).axes


@pytest.mark.slow
@pytest.mark.parametrize("flavour", run_module.FLAVOURS)
def test_the_vehicles_that_come_along_answer_as_the_simulated_ones_do(
    flavour: str, tmp_path: Path
) -> None:
    fly(tmp_path, excitation=ExcitationSettings(right_m_s=0, vertical_m_s=0), flavour=flavour)
    found, known = identification([read_recording(tmp_path)]).fits, find_vehicle(flavour).vehicle
    for axis in (VehicleAxis.FORWARD, VehicleAxis.YAW_RATE):
        assert found[axis].model.dead_time_s == pytest.approx(known[axis].dead_time_s, abs=0.01)
        assert found[axis].model.order == known[axis].order


@pytest.mark.slow
def test_a_gap_in_the_log_is_no_setpoint_that_stood_for_so_long(
    flown: tuple[Path, ExcitationFlight], tmp_path: Path
) -> None:
    """As where the disk was too slow for the log."""
    flight = open_flight(flown[0])
    asked = [one.time_s for one in flight.log.controls if one.allowed.forward_m_s > 0.7]
    gap = range(math.floor(asked[0]) + 2, math.floor(asked[0]) + 5)
    with McapLog(tmp_path / "flight.mcap", flight.config.epoch_ns, flight.config.to_yaml()) as log:
        for time_s, message in flight.messages():
            if math.floor(time_s) not in gap:
                log.write(message, time_s)
    read = read_recording(tmp_path)
    for one in read.axes[VehicleAxis.FORWARD]:
        assert np.diff(one.output_s).max() < 0.3
    assert any("3.0 s are missing in its log" in remark for remark in read.remarks)
    assert identification([read]).fits[VehicleAxis.FORWARD].held_out_fit > 0.6


@pytest.mark.parametrize(("at_s", "next_step"), [(0.0, False), (2.02, True)])
def test_ctrl_c_holds_releases_and_says_how_far_it_came_and_what_is_next(
    at_s: float,
    next_step: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    watched, pressed = run_module._with, list[float]()

    def interrupted(recorder: Recorder, watch: run_module.OnStep) -> run_module.OnStep:
        def step(flight: ExcitationFlight) -> None:
            if flight.stage.elapsed_s >= at_s and not pressed:
                pressed.append(flight.stage.elapsed_s)
                signal.raise_signal(signal.SIGINT)
            watch(flight)

        return watched(recorder, step)

    monkeypatch.setattr(run_module, "_with", interrupted)
    run = run_module.ExcitationRun(SHORT, None, "px4", tmp_path, 0.0, 0, "follower excite")
    assert run_module.excite(run, None, ()) == 1
    told = capsys.readouterr().out
    assert ("Ended as asked after 2 of" if next_step else "after 0 of") in told
    assert ("Next: follower identify" in told) is next_step
    log = open_flight(tmp_path / "excite").log
    assert log.controls[-1].state is SupervisorState.RELEASED
    assert log.controls[-1].allowed.values == pytest.approx(HOLD.values, abs=1e-6)


@pytest.mark.slow
def test_in_the_simulator_nobody_is_waited_for(tmp_path: Path) -> None:
    """By a real vehicle's settings it would be for a pilot, and an operator's consent."""
    run = run_module.ExcitationRun(SHORT, None, "px4", tmp_path, 0.0, 0, "follower excite")
    settings = configs_folder() / "fly" / "px4.yaml"
    assert run_module.excite(run, settings, ("consent.kind=command",)) == 0


def test_a_seed_below_zero_is_refused_before_anything_is_flown() -> None:
    refused = CliRunner().invoke(app, ["excite", "--seed", "-1", "--wind", "3"])
    assert refused.exit_code == 2
    assert "--seed" in refused.output
