"""What the two links cost and how soon each ends a velocity when the control loop stands still.

A simulated PX4 over UDP on this machine; run it on a quiet one:

    python benchmarks/link_speed.py
"""

from __future__ import annotations

import statistics
import time
from contextlib import ExitStack
from typing import Any

import command_line
from pymavlink.dialects.v20 import common as mavlink

from follower.links.open import open_link
from follower.settings.link import LinkSettings
from follower_control.common.transport import Transport, UdpTransport
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint
from follower_sim.autopilot.autopilot import SimAutopilot, autopilot_thread
from follower_sim.kinematics import BodyState
from follower_vision.clock import MonotonicClock

PERIOD_S, MEASURED_S, STALLS = 0.02, 10.0, 10
FORWARD = VelocitySetpoint(2.0)


class Wire:
    """A transport that notes when setpoints leave."""

    def __init__(self, inner: Transport) -> None:
        self._inner = inner
        self.receive, self.close = inner.receive, inner.close
        self.setpoints: list[tuple[float, float]] = []

    def send(self, data: bytes) -> None:
        """Send one packet."""
        message: Any = mavlink.MAVLink(None).decode(bytearray(data))
        if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
            self.setpoints.append((time.monotonic(), message.vx))
        self._inner.send(data)


class Bench:
    """One link and one simulated autopilot."""

    def __init__(self, kind: str) -> None:
        self.clock = clock = MonotonicClock()
        listener = UdpTransport.listen("127.0.0.1", 0)
        self._theirs = UdpTransport.connect("127.0.0.1", listener.port)
        start = BodyState(clock.now(), (0.0, 0.0, -20.0))
        self.autopilot = SimAutopilot("px4", self._theirs, start)
        self._thread = ExitStack()
        self._thread.enter_context(autopilot_thread(self.autopilot, clock))
        self.wire = Wire(listener)
        settings = LinkSettings(kind=kind, vehicle_id=1)
        self.link = open_link(self.wire, settings, clock, 0)

    def close(self) -> None:
        """End everything."""
        self.link.close()
        self._thread.close()
        self._theirs.close()

    def run(self, seconds: float, setpoint: VelocitySetpoint) -> list[float]:
        """Be a control loop; return how long poll and send took each time."""
        took = []
        for _ in range(round(seconds / PERIOD_S)):
            began = time.perf_counter()
            self.link.poll(self.clock.now())
            self.link.send(setpoint)
            took.append(time.perf_counter() - began)
            time.sleep(PERIOD_S)
        return took

    def engage(self) -> None:
        """Bring the vehicle into OFFBOARD and wait until its heartbeat says so."""
        self.run(0.3, HOLD)
        while not self.link.state.obeys_setpoints:
            self.link.enter_setpoint_mode()
            self.run(0.4, HOLD)

    def stall(self) -> tuple[float, bool]:
        """Stand still; return when zero left, and whether the vehicle left OFFBOARD."""
        self.run(0.2, FORWARD)
        stalled = time.monotonic()
        time.sleep(0.6)
        zeros = [at - stalled for at, vx in self.wire.setpoints if at > stalled and vx == 0.0]
        left = self.autopilot.mode != "OFFBOARD"
        self.run(1.2, HOLD)
        return min(zeros, default=float("nan")), left


def measure(kind: str) -> None:
    """Measure one link and print it."""
    bench = Bench(kind)
    bench.run(3.0, HOLD)
    bench.engage()
    before = len(bench.wire.setpoints)
    took = sorted(bench.run(MEASURED_S, FORWARD))
    sent = bench.wire.setpoints[before:]
    status = bench.link.status(bench.clock.now())
    stalls = []
    for _ in range(STALLS):
        bench.engage()
        stalls.append(bench.stall())
    bench.close()
    zeros, left = [zero for zero, _ in stalls], sum(left for _, left in stalls)
    print(
        f"{kind}: poll and send {1e3 * statistics.median(took):.2f} ms median, "
        f"{1e3 * took[int(0.99 * len(took))]:.2f} ms 99th percentile; setpoints leave at "
        f"{(len(sent) - 1) / (sent[-1][0] - sent[0][0]):.1f} Hz; {status.line()}; "
        f"clock known to {1e3 * (status.clock_error_s or 0.0):.1f} ms"
    )
    print(
        f"  {STALLS} stalls: zero velocity left after {statistics.median(zeros):.3f} s, "
        f"{max(zeros):.3f} s at worst; OFFBOARD left within 0.6 s: {left}"
    )


def main() -> None:
    """Measure both."""
    command_line.parser(__doc__).parse_args()
    for kind in ("pymavlink", "mavsdk"):
        measure(kind)


if __name__ == "__main__":
    command_line.run(main)
