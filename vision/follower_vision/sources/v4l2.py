"""What a V4L2 camera offers, and its controls by their names: ioctls of linux/videodev2.h."""

from __future__ import annotations

import errno
import os
import re
import struct
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from fcntl import ioctl
from typing import Any, NamedTuple, TypeAlias

from follower_vision.sources.capture import CaptureSettings
from follower_vision.sources.frame_source import SourceError


class _Request(NamedTuple):
    """An ioctl that reads and writes one structure."""

    number: int
    layout: struct.Struct

    @property
    def code(self) -> int:
        return 3 << 30 | self.layout.size << 16 | ord("V") << 8 | self.number


_ENUM_FMT = _Request(2, struct.Struct("=III32s4sI12x"))
_ENUM_FRAMESIZES = _Request(74, struct.Struct("=I4sI6I8x"))
_ENUM_FRAMEINTERVALS = _Request(75, struct.Struct("=I4sIII6I8x"))
_QUERYCTRL = _Request(36, struct.Struct("=II32siiiiI8x"))
_QUERYMENU = _Request(37, struct.Struct("=II32s4x"))
_S_CTRL = _Request(28, struct.Struct("=Ii"))
_CAPTURE, _DISCRETE = 1, 1
_INTEGER, _BOOLEAN, _MENU, _INTEGER_MENU = 1, 2, 3, 9
_NEXT, _DISABLED, _READ_ONLY = 0x80000000, 0x1, 0x4

Size: TypeAlias = tuple[int, int]
Ioctl: TypeAlias = Callable[[int, int, bytes], bytes]


@dataclass(frozen=True, slots=True)
class Control:
    """One control: its driver's number, kind, range and, of a menu, entries by their names."""

    number: int
    kind: int
    least: int
    most: int
    entries: dict[str, int] = field(default_factory=dict)

    def __str__(self) -> str:
        if self.kind == _BOOLEAN:
            return "true or false"
        return ", ".join(self.entries) if self.entries else f"{self.least} to {self.most}"

    def raw(self, value: object) -> int | None:
        """Return what the driver is given for a value; None if it takes no such value."""
        if isinstance(value, str):
            return self.entries.get(_key(value))
        if not isinstance(value, int) or (isinstance(value, bool) and self.kind != _BOOLEAN):
            return None
        within = (
            value in self.entries.values() if self.entries else self.least <= value <= self.most
        )
        return int(value) if within else None


class V4l2Device:
    """A camera's V4L2 device, beside whoever reads its pictures.

    Args:
        path: such as "/dev/video0".
        call: the system's ioctl.

    Raises:
        SourceError: it cannot be opened.
    """

    def __init__(self, path: str, call: Ioctl = ioctl) -> None:
        self._path, self._ioctl = path, call
        try:
            self._file = os.open(path, os.O_RDWR | os.O_NONBLOCK)
        except OSError as error:
            raise SourceError(f"{path}: cannot be opened ({error.strerror})") from error

    def close(self) -> None:
        """Close it."""
        os.close(self._file)

    def formats(self) -> dict[str, dict[Size, tuple[float, ...]]]:
        """Return rates (Hz) by size by pixel format; no sizes where the driver takes any."""
        found: dict[str, dict[Size, tuple[float, ...]]] = {}
        for _, _, _, _, code, _ in self._each(_ENUM_FMT, _CAPTURE, 0, b"", b"", 0):
            sizes = self._each(_ENUM_FRAMESIZES, code, *[0] * 7)
            found[code.decode("ascii", "replace").strip()] = {
                (width, height): self._rates(code, width, height)
                for _, _, kind, width, height, *_ in sizes
                if kind == _DISCRETE
            }
        return found

    def controls(self) -> dict[str, Control]:
        """Return the controls that can be set by name, as `v4l2-ctl -L` names them."""
        found, number = {}, 0
        while (
            answer := self._asked(_QUERYCTRL, number | _NEXT, 0, b"", 0, 0, 0, 0, 0)
        ) is not None:
            number, kind, name, least, most, _, _, flags = answer
            if flags & (_DISABLED | _READ_ONLY):
                continue
            if kind in (_MENU, _INTEGER_MENU):
                entries = dict(self._entries(number, kind, least, most))
                found[_key(_text(name))] = Control(number, kind, least, most, entries)
            elif kind in (_INTEGER, _BOOLEAN):
                found[_key(_text(name))] = Control(number, kind, least, most)
        return found

    def set_controls(self, wanted: dict[str, bool | int | float | str]) -> None:
        """Set controls; menus and switches first: what is automatic must be off for a number.

        Raises:
            SourceError: there is no such control or value; the message lists what there is.
        """
        known = self.controls()
        for name in wanted:
            if name not in known:
                listed = ", ".join(sorted(known)) or "none"
                raise SourceError(f"{self._path}: no control {name!r}; there are {listed}")
        for name in sorted(wanted, key=lambda name: known[name].kind == _INTEGER):
            value, control = wanted[name], known[name]
            raw = control.raw(value)
            if raw is None:
                raise SourceError(f"{self._path}: {name} is {control}, not {value!r}")
            try:
                self._ioctl(self._file, _S_CTRL.code, _S_CTRL.layout.pack(control.number, raw))
            except OSError as error:
                raise SourceError(
                    f"{self._path}: {name} cannot be set to {value!r} ({error.strerror}); "
                    "is its automatic on?"
                ) from error

    def _entries(self, number: int, kind: int, least: int, most: int) -> Iterator[tuple[str, int]]:
        for index in range(least, most + 1):
            answer = self._asked(_QUERYMENU, number, index, b"")
            if answer is not None:
                name = answer[2]
                integer = str(struct.unpack("=q", name[:8])[0])
                yield integer if kind == _INTEGER_MENU else _key(_text(name)), index

    def _rates(self, code: bytes, width: int, height: int) -> tuple[float, ...]:
        intervals = self._each(_ENUM_FRAMEINTERVALS, code, width, height, *[0] * 7)
        return tuple(
            below / above
            for _, _, _, _, kind, above, below, *_ in intervals
            if kind == _DISCRETE and above
        )

    def _each(self, request: _Request, *fields: object) -> Iterator[tuple[Any, ...]]:
        index = 0
        while (answer := self._asked(request, index, *fields)) is not None:
            yield answer
            index += 1

    def _asked(self, request: _Request, *fields: object) -> tuple[Any, ...] | None:
        """Return the filled structure, None where there is nothing (more)."""
        try:
            answer = self._ioctl(self._file, request.code, request.layout.pack(*fields))
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.ENOTTY):
                return None
            raise SourceError(f"{self._path}: {error.strerror}; is it a camera?") from error
        return request.layout.unpack(answer)


def prepare(path: str, capture: CaptureSettings) -> None:
    """Set a camera's controls, and refuse a format, size or rate that it does not offer.

    Raises:
        SourceError: it cannot do what is asked; the message lists what it can.
    """
    with closing(V4l2Device(path)) as device:
        check_offer(path, device.formats(), capture)
        device.set_controls(capture.controls)


def check_offer(
    path: str, offered: dict[str, dict[Size, tuple[float, ...]]], capture: CaptureSettings
) -> None:
    """Refuse what is not among the formats, sizes and rates offered.

    Raises:
        SourceError: the message lists what is offered.
    """
    if capture.format is not None and capture.format not in offered:
        raise SourceError(f"{path}: no format {capture.format}; there are {', '.join(offered)}")
    chosen = [capture.format] if capture.format is not None else list(offered)
    sizes = {size for name in chosen for size in offered[name]}
    if capture.size is not None and sizes and capture.size not in sizes:
        listed = ", ".join(f"{width}x{height}" for width, height in sorted(sizes))
        raise SourceError(f"{path}: no size {'{}x{}'.format(*capture.size)}; there are {listed}")
    wanted = [capture.size] if capture.size is not None else sizes
    rates = {rate for name in chosen for size in wanted for rate in offered[name].get(size, ())}
    rate_hz = capture.rate_hz
    if rate_hz is not None and rates and all(abs(rate - rate_hz) > 0.01 * rate for rate in rates):
        listed = ", ".join(f"{rate:g}" for rate in sorted(rates))
        raise SourceError(f"{path}: not {rate_hz:g} frames a second; there are {listed}")


def _text(name: bytes) -> str:
    return name.split(b"\0")[0].decode("utf-8", "replace")


def _key(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
