"""Our simulated autopilot as a program: python -m …simulated_autopilot FLAVOUR PORT SPEED LOG."""

import csv
import signal
import sys
import threading
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np

from follower_control.common.transport import UdpTransport
from follower_sim.autopilot.autopilot import SimAutopilot, run_autopilot
from follower_sim.kinematics import BodyState
from follower_sim.scenario.scenario import WindSettings
from follower_sim.world.wind import Wind
from follower_vision.clock import MonotonicClock

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
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    wind = Wind(settings, np.random.default_rng(0)).velocity_m_s
    transport = UdpTransport.connect("127.0.0.1", int(port))
    with closing(transport), Path(log).open("w", newline="", encoding="utf-8") as file:
        autopilot = SimAutopilot(flavour, transport, BodyState(0.0, (0.0, 0.0, 0.0)), wind)
        autopilot.parameters.update(values)
        rows = csv.writer(file)
        rows.writerow(_COLUMNS)

        def note(now_s: float) -> None:
            state = autopilot.state
            motion = (*state.position_m, *state.velocity_m_s, *state.attitude_rad)
            rows.writerow((f"{now_s:.3f}", autopilot.mode, int(autopilot.armed), *motion))

        autopilot.on_step = note
        run_autopilot(autopilot, MonotonicClock(float(speed)), stop)


if __name__ == "__main__":
    main(sys.argv[1:])
