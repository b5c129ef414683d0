"""The live terminal, and the score at the end. Angles are shown in degrees."""

import math
from typing import Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from follower.flight.status import LiveStatus
from follower.ui.terminal.console import print_line
from follower_control.vehicle.setpoint import VelocitySetpoint
from follower_vision.clock import Clock, MonotonicClock

STATE_STYLES = {
    "idle": "dim",
    "tracking": "cyan",
    "ready": "bright_blue",
    "following": "green",
    "coasting": "yellow",
    "searching": "dark_orange",
    "holding": "red",
    "released": "magenta",
}

_DRAW_S = 0.1
_PLAIN_S = 5.0
_UNKNOWN = "–"


class LiveDisplay:
    """A live display on a terminal while entered; into a file or pipe, lines.

    Args:
        console: where to.
        clock: the reader's time, not the flight's.
    """

    def __init__(self, console: Console, clock: Clock | None = None) -> None:
        self._console = console
        self._clock = clock or MonotonicClock()
        self._live: Live | None = None
        self._shown_s = -math.inf

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._live = Live(console=self._console, auto_refresh=False)
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()
            self._live = None

    def say(self, text: str) -> None:
        """Write a line that stays."""
        print_line(self._console, text)


class FlightDisplay(LiveDisplay):
    """Shows a flight while it goes on.

    On a terminal it redraws one small table ten times a second; into a file or pipe it writes a
    line every five seconds and at each change of state. `show` may be called as often as one
    likes: what comes too early is left out.

    Args:
        console: where to.
        title: stands above the table.
        clock: the reader's time, not the flight's.
    """

    def __init__(
        self,
        console: Console,
        title: str = "",
        clock: Clock | None = None,
    ) -> None:
        super().__init__(console, clock)
        self._title = title
        self._shown_state = ""

    def __enter__(self) -> Self:
        super().__enter__()
        if self._live is None and self._title:
            self.say(self._title)
        return self

    def show(self, status: LiveStatus) -> None:
        """Show a status if it is time to."""
        now_s = self._clock.now()
        period_s = _PLAIN_S if self._live is None else _DRAW_S
        is_new = self._live is None and status.state != self._shown_state
        if now_s - self._shown_s < period_s and not is_new:
            return
        self._shown_s, self._shown_state = now_s, status.state
        if self._live is None:
            self.say(plain_line(status))
        else:
            self._live.update(status_table(status, self._title), refresh=True)


def plain_line(status: LiveStatus) -> str:
    """Return a status in one line."""
    lasts = status.total_s is not None and status.elapsed_s <= status.total_s  # then it ends
    total = f"/{status.total_s:.0f}" if lasts else ""
    parts = [
        f"{status.elapsed_s:6.1f}{total} s",
        f"{status.state} ({_why(status)})",
        f"off by {_direction(status, 0)}",
        f"range {_number(status.range_m, '.1f', 'm')}",
        f"sent {_speed(status.allowed)}",
        f"flown {_speed(status.flown)}",
        f"{_number(status.frame_rate_hz, '.0f', 'frames/s')}",
        f"control {_number(_milli(status.control_s), '.2f', 'ms')}",
    ]
    return "  ".join(parts)


def status_table(status: LiveStatus, title: str = "") -> RenderableType:
    """Return a status as a table of a few lines."""
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", min_width=12)
    table.add_column(min_width=60)
    state = Text.assemble(
        (f"{status.state.upper()}", f"bold {STATE_STYLES.get(status.state, '')}"),
        f"  {_why(status)}",
    )
    table.add_row("state", state)
    table.add_row("off by", _direction(status))
    table.add_row("range", _number(status.range_m, ".1f", "m"))
    table.add_row("asked", _velocity(status.asked))
    table.add_row("allowed", _velocity(status.allowed))
    table.add_row("flown", _velocity(status.flown))
    table.add_row("vision", _vision(status))
    table.add_row("control", _control(status))
    if status.link:
        table.add_row("link", Text(status.link))
    heading = [Text(title, "bold")] if title else []
    return Group(*heading, table, _progress(status))


def _why(status: LiveStatus) -> str:
    phase = "" if status.phase == status.state else status.phase
    return ", ".join(part for part in (status.reason, phase) if part) or _UNKNOWN


def _direction(status: LiveStatus, width: int = 6) -> str:
    azimuth, elevation = status.azimuth_error_rad, status.elevation_error_rad
    if azimuth is None or elevation is None:
        return _UNKNOWN
    form = f"+{width}.1f" if width else "+.1f"
    return f"{math.degrees(azimuth):{form}}° right {math.degrees(elevation):{form}}° up"


def _velocity(setpoint: VelocitySetpoint | None) -> str:
    if setpoint is None:
        return _UNKNOWN
    forward, right, down, yaw_rate = setpoint.values
    # Adding zero turns -0.0 into 0.0, which would be shown as "-0.0".
    return (
        f"forward {forward + 0.0:+6.2f}  right {right + 0.0:+6.2f}  up {0.0 - down:+6.2f} m/s  "
        f"yaw {math.degrees(yaw_rate) + 0.0:+6.1f} °/s"
    )


def _speed(setpoint: VelocitySetpoint | None) -> str:
    if setpoint is None:
        return _UNKNOWN
    speed = math.hypot(setpoint.forward_m_s, setpoint.right_m_s, setpoint.down_m_s)
    return f"{speed:.1f} m/s {math.degrees(setpoint.yaw_rate_rad_s):+.0f} °/s"


def _vision(status: LiveStatus) -> str:
    confidence = _number(status.confidence, ".2f", "")
    rate = _number(status.frame_rate_hz, ".0f", "frames/s")
    work = _number(_milli(status.vision_s), ".1f", "ms a frame")
    return f"{status.track or 'no target':<9} {confidence.strip()}   {rate}   {work}"


def _control(status: LiveStatus) -> str:
    work = _number(_milli(status.control_s), ".2f", "ms a step")
    return f"{work}   {_number(_milli(status.late_s), '.2f', 'ms late')}"


def _progress(status: LiveStatus) -> RenderableType:
    if status.total_s is None:
        return Text(f"{status.elapsed_s:.1f} s", "dim")
    row = Table.grid(padding=(0, 2))
    bar = ProgressBar(
        status.total_s, status.elapsed_s, width=50, complete_style="green", finished_style="green"
    )
    row.add_row(bar, f"{status.elapsed_s:.1f} of {status.total_s:.0f} s")
    return row


def _milli(value: float | None) -> float | None:
    return None if value is None else 1e3 * value


def _number(value: float | None, form: str, unit: str) -> str:
    return _UNKNOWN if value is None else f"{value:{form}} {unit}".rstrip()
