"""Flying without a pilot on autopilots as they really are: late, armed already, in the air."""

import pytest

from follower.flight.lockstep import Lockstep
from follower.flight.supervision.autonomy import Autonomy, AutonomyPhase
from follower.flight.supervision.supervisor import SupervisorState
from follower.links.pymavlink_link import MavlinkLink
from follower.settings.link import LinkSettings
from follower_control.common.transport import MemoryTransport
from follower_sim.autopilot.autopilot import SYSTEM_ID, SimAutopilot
from follower_sim.kinematics import BodyState
from follower_vision.clock import SimulatedClock

HEIGHT_M = 6.0
HOVER = {"px4": "LOITER", "ardupilot": "BRAKE"}


class Bench:
    """An autopilot and the played pilot on one simulated clock, without a control loop."""

    def __init__(self, flavour: str, down_m: float = 0.0) -> None:
        self.clock = SimulatedClock()
        ours, theirs = MemoryTransport.pair()
        self.autopilot = SimAutopilot(flavour, theirs, BodyState(0.0, (0.0, 0.0, down_m)))
        self.link = MavlinkLink(ours, LinkSettings(vehicle_id=SYSTEM_ID))
        self.autonomy = Autonomy(self.link, HEIGHT_M)
        self.phases = [self.autonomy.phase]
        self.notes: list[str] = []
        self._lockstep = Lockstep(self.clock)
        self._lockstep.every(0.005, lambda: self.autopilot.step(self.clock.now()))
        self._lockstep.every(0.02, self._step)

    def fly(self, until_s: float, stop_at: AutonomyPhase = AutonomyPhase.AIRBORNE) -> AutonomyPhase:
        self._lockstep.run(
            lambda: self.clock.now() > until_s or self.autonomy.phase is stop_at,
        )
        return self.autonomy.phase

    @property
    def height_m(self) -> float:
        return -self.autopilot.state.position_m[2]

    def _step(self) -> None:
        self.link.poll(self.clock.now())
        self.notes += self.link.take_notes()
        self.autonomy.step(self.clock.now(), SupervisorState.IDLE)
        if self.autonomy.phase is not self.phases[-1]:
            self.phases.append(self.autonomy.phase)


@pytest.mark.parametrize("flavour", ["px4", "ardupilot"])
def test_a_vehicle_left_hovering_is_taken_over_where_it_is(flavour: str) -> None:
    bench = Bench(flavour, down_m=-9.0)
    bench.autopilot.switch_mode(HOVER[flavour])
    assert bench.fly(8.0) is AutonomyPhase.AIRBORNE
    assert AutonomyPhase.TAKING_OFF not in bench.phases
    assert bench.clock.now() < 3.0
    assert bench.height_m == pytest.approx(9.0, abs=0.2)
    assert not any("TAKEOFF" in note for note in bench.notes)


@pytest.mark.slow
@pytest.mark.parametrize("flavour", ["px4", "ardupilot"])
def test_a_vehicle_that_is_landing_is_waited_for_and_taken_off_again(flavour: str) -> None:
    bench = Bench(flavour, down_m=-2.0)
    bench.autopilot.switch_mode("LAND")
    assert bench.fly(40.0) is AutonomyPhase.AIRBORNE
    assert AutonomyPhase.TAKING_OFF in bench.phases
    assert bench.height_m == pytest.approx(HEIGHT_M, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("flavour", ["px4", "ardupilot"])
def test_one_that_disarms_before_it_took_off_is_armed_again(flavour: str) -> None:
    bench = Bench(flavour)
    assert bench.fly(10.0, AutonomyPhase.TAKING_OFF) is AutonomyPhase.TAKING_OFF
    assert bench.autopilot._controller.disarm(force=True)
    assert bench.fly(25.0) is AutonomyPhase.AIRBORNE
    assert bench.phases.count(AutonomyPhase.ARMING) == 2
    assert bench.height_m == pytest.approx(HEIGHT_M, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("flavour", ["px4", "ardupilot"])
def test_an_estimator_that_settles_late_is_waited_for(flavour: str) -> None:
    bench = Bench(flavour)
    bench.autopilot.health.settled_s, bench.autopilot.health.fit_s = 25.0, 30.0
    assert bench.fly(24.0) is AutonomyPhase.CONNECTING
    assert bench.fly(29.0) is AutonomyPhase.ARMING
    assert not bench.autopilot.armed
    assert bench.autopilot._controller.firmware.unfit_text[:50] in bench.notes
    assert bench.fly(45.0) is AutonomyPhase.AIRBORNE


def test_a_fit_autopilot_that_says_nothing_of_the_ground_is_judged_by_its_height() -> None:
    bench = Bench("px4", down_m=-9.0)
    bench.autopilot._telemetry._builders["EXTENDED_SYS_STATE"] = lambda _: None
    assert bench.fly(8.0) is AutonomyPhase.AIRBORNE
    assert bench.height_m == pytest.approx(9.0, abs=0.2)
