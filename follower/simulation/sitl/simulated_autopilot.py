"""Our simulated autopilot as a program: python -m …simulated_autopilot FLAVOUR PORT SPEED LOG."""

import csv
import signal
import sys
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from types import FrameType

import numpy as np

from follower_control.common.transport import UdpTransport
from follower_sim.autopilot.autopilot import SimAutopilot
from follower_sim.kinematics import BodyState
from follower_sim.scenario.scenario import WindSettings
from follower_sim.vehicle.vehicle import STEP_S
from follower_sim.world.wind import Wind
from follower_vision.clock import MonotonicClock

_LOG_EVERY_S = 0.02
_WIND = {"WIND_MEAN": "mean_m_s", "WIND_FROM": "from_deg", "WIND_GUST": "gust_m_s"}
_COLUMNS = (
    *("time_s", "mode", "armed", "north_m", "east_m", "down_m"),
    *("north_m_s", "east_m_s", "down_m_s", "roll_rad", "pitch_rad", "yaw_rad"),
)


def main(arguments: Sequence[str]) -> None:
    """Fly until SIGINT; stands on the ground, facing north, at first."""
    flavour, port, speed, log, *parameters = arguments
    values = {name: float(value) for name, value in (text.split("=") for text in parameters)}
    settings = WindSettings(**{key: values.pop(name, 0.0) for name, key in _WIND.items()})
    stopped: list[int] = []

    def stop(number: int, _frame: FrameType | None) -> None:
        stopped.append(number)

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    clock = MonotonicClock(float(speed))
    wind = Wind(settings, np.random.default_rng(0)).velocity_m_s
    transport = UdpTransport.connect("127.0.0.1", int(port))
    with closing(transport), Path(log).open("w", newline="", encoding="utf-8") as file:
        autopilot = SimAutopilot(flavour, transport, BodyState(0.0, (0.0, 0.0, 0.0)), wind)
        autopilot.parameters.update(values)
        rows = csv.writer(file)
        rows.writerow(_COLUMNS)
        logged_s = 0.0
        while not stopped:
            now_s = clock.now()
            autopilot.step(now_s)
            if now_s >= logged_s:
                logged_s = now_s + _LOG_EVERY_S
                state = autopilot.state
                motion = (*state.position_m, *state.velocity_m_s, *state.attitude_rad)
                rows.writerow((f"{now_s:.3f}", autopilot.mode, int(autopilot.armed), *motion))
            clock.sleep_until(now_s + STEP_S)


if __name__ == "__main__":
    main(sys.argv[1:])
