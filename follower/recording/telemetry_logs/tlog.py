"""Telemetry from a tlog, as Mission Planner, QGroundControl, MAVProxy and we write it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower.links.modes import mode_name
from follower.recording.telemetry_logs.samples import TelemetryError, TelemetrySamples
from follower.recording.tlog import read_tlog

_REBOOT_S = 1.0


def read_mavlink(path: Path) -> TelemetrySamples:
    """Read a tlog, the messages of the first vehicle that is heard in it.

    Attitudes and positions carry the autopilot's own time since boot, which is free of the link's
    delays; it is brought onto the log's time by the smallest delay.

    Raises:
        TelemetryError: there is not one MAVLink message in it.
        OSError: it cannot be read.
    """
    samples, clock, heard = TelemetrySamples(), _BootClock(), None
    for arrival_s, message in _messages(path):
        kind = message.get_type()
        if kind == "HEARTBEAT" and message.autopilot != mavlink.MAV_AUTOPILOT_INVALID:
            heard = heard or message.get_srcSystem()
        if heard is None or message.get_srcSystem() != heard:
            continue
        if kind == "ATTITUDE":
            clock.take(message, arrival_s, samples.attitudes)
            samples.attitude_rates.append((message.rollspeed, message.pitchspeed, message.yawspeed))
            samples.attitudes.append((0.0, message.roll, message.pitch, message.yaw))
        elif kind == "LOCAL_POSITION_NED":
            clock.take(message, arrival_s, samples.positions)
            m = message
            samples.positions.append((0.0, m.x, m.y, m.z, m.vx, m.vy, m.vz))
        elif kind == "HEARTBEAT":
            armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            mode = mode_name(message.autopilot, message.custom_mode)
            samples.add_mode(arrival_s, mode, armed)
    clock.settle()
    return samples


class _BootClock:
    """Brings times since boot onto the log's time, once all are known.

    Each stretch between two boots has an offset of its own: the smallest (arrival - boot).
    """

    def __init__(self) -> None:
        self._offsets: list[float] = []
        self._boot_s = 0.0
        self._stamps: list[tuple[list[tuple[float, ...]], int, float, int]] = []

    def take(self, message: Any, arrival_s: float, rows: list[tuple[float, ...]]) -> None:
        """Remember that the next row to be added belongs to this message."""
        boot_s = message.time_boot_ms / 1000
        if not self._offsets or boot_s < self._boot_s - _REBOOT_S:
            self._offsets.append(arrival_s - boot_s)
        self._offsets[-1] = min(self._offsets[-1], arrival_s - boot_s)
        self._boot_s = boot_s
        self._stamps.append((rows, len(rows), boot_s, len(self._offsets) - 1))

    def settle(self) -> None:
        """Write the times into the rows."""
        for rows, index, boot_s, number in self._stamps:
            rows[index] = (boot_s + self._offsets[number], *rows[index][1:])


def _messages(path: Path) -> Iterator[tuple[float, Any]]:
    codec = mavlink.MAVLink(None)
    codec.robust_parsing = True
    count, first_s = 0, 0.0
    for packet in read_tlog(path):
        for message in codec.parse_buffer(packet.data) or []:
            # Times since 1970 would leave fewer digits for what comes behind the point.
            first_s = first_s if count else packet.time_s
            count += 1
            yield packet.time_s - first_s, message
    if not count:
        raise TelemetryError(f"{path}: there is no MAVLink message in it: this is no tlog")
