"""Checks of the companion computer."""

from __future__ import annotations

from follower.preflight.finding import Finding, failed, passed, unknown, warned
from follower.preflight.snapshot import Snapshot

_GB = 1e9
_LITTLE, _TOO_LITTLE = 4 * _GB, 0.5 * _GB
_WARM_C, _HOT_C = 75.0, 85.0
_BUSY, _TOO_BUSY = 0.7, 1.5
_UNDER_VOLTAGE, _THROTTLED = 0x1, 0x2 | 0x4 | 0x8
_BEFORE = 16


def disk(s: Snapshot) -> Finding:
    """There is room for the recording."""
    free = s.computer.free_bytes
    if free is None:
        return unknown(f"the room in {s.computer.folder} cannot be read")
    text = f"{free / _GB:.1f} GB free in {s.computer.folder}"
    if free >= _LITTLE:
        return passed(text)
    todo = "delete old runs, or name another place by --out"
    return warned(text, todo) if free >= _TOO_LITTLE else failed(text, todo)


def temperature(s: Snapshot) -> Finding:
    """The processor is not near the heat at which it slows down."""
    degrees = s.computer.temperature_c
    if degrees is None:
        return unknown("this computer does not tell")
    text = f"{degrees:.0f} °C"
    if degrees < _WARM_C:
        return passed(text)
    todo = "cool it: a heat sink, a fan, the propellers' wind"
    return warned(text, todo) if degrees < _HOT_C else failed(text, todo)


def throttling(s: Snapshot) -> Finding:
    """The processor is not slowed down, and the supply holds."""
    flags = s.computer.throttled
    if flags is None:
        return unknown("this computer does not tell")
    now, before = flags & 0xFFFF, flags >> _BEFORE
    if now & _UNDER_VOLTAGE:
        return failed("the supply's voltage is too low", "a stronger supply, shorter cables")
    if now & _THROTTLED:
        return failed("the processor is slowed down now", "cool it")
    if before & (_UNDER_VOLTAGE | _THROTTLED):
        return warned(
            "it was slowed down or short of voltage since its start", "see to supply, heat"
        )
    return passed("never since its start")


def load(s: Snapshot) -> Finding:
    """There is computing time to spare."""
    share = s.computer.load
    if share is None:
        return unknown("this computer does not tell")
    text = f"load {share:.2f} a core"
    if share < _BUSY:
        return passed(text)
    todo = "end other programs"
    return warned(text, todo) if share < _TOO_BUSY else failed(text, todo)
