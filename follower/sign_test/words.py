"""What the sign test shows: words and a small picture made of characters."""

from __future__ import annotations

import math
from collections.abc import Sequence

from follower.sign_test.dry_run import Wish
from follower.sign_test.evidence import Judgement, Sign, gain_remark
from follower_control.setpoint import VelocitySetpoint
from follower_vision.box import Box
from follower_vision.lineofsight import CameraMount

_STILL_DEG_S, _STILL_M_S, _CENTRED_DEG = 2.0, 0.1, 2.0
_COLUMNS, _ROWS = 41, 11
_MOVES = {
    "yaw": "turn the vehicle left and right by hand, 15 degrees each way",
    "pitch": "raise and lower its nose by hand, 15 degrees each way",
    "roll": "roll it by hand, 15 degrees each way",
}


def where(wish: Wish) -> str:
    """Return where the target is: "12° right of the nose, 5° below the horizon"."""
    azimuth, elevation = (
        math.degrees(angle) for angle in (wish.sight.azimuth_rad, wish.sight.elevation_rad)
    )
    side = "right of the nose" if azimuth > 0 else "left of the nose"
    height = "above the horizon" if elevation > 0 else "below the horizon"
    parts = [f"{abs(azimuth):.0f}° {side}" if abs(azimuth) >= _CENTRED_DEG else "ahead"]
    parts += [f"{abs(elevation):.0f}° {height}"] if abs(elevation) >= _CENTRED_DEG else ["level"]
    return "target " + ", ".join(parts)


def intent(setpoint: VelocitySetpoint) -> str:
    """Return what would be flown: "would yaw RIGHT (clockwise) 18°/s, SINK 0.4 m/s"."""
    yaw_deg = math.degrees(setpoint.yaw_rate_rad_s)
    parts = []
    if abs(yaw_deg) >= _STILL_DEG_S:
        side = "RIGHT (clockwise)" if yaw_deg > 0 else "LEFT (anticlockwise)"
        parts.append(f"yaw {side} {abs(yaw_deg):.0f}°/s")
    for speed, positive, negative in (
        (setpoint.down_m_s, "SINK", "CLIMB"),
        (setpoint.forward_m_s, "go FORWARD", "BACK OFF"),
        (setpoint.right_m_s, "go RIGHT", "go LEFT"),
    ):
        if abs(speed) >= _STILL_M_S:
            parts.append(f"{positive if speed > 0 else negative} {abs(speed):.1f} m/s")
    return "would " + (", ".join(parts) if parts else "stay as it is")


def picture(
    box: Box | None, size: tuple[int, int], setpoint: VelocitySetpoint | None = None
) -> list[str]:
    """Return the image as lines of characters: the target, the centre and the turn to come."""
    rows = [[" "] * _COLUMNS for _ in range(_ROWS)]
    rows[_ROWS // 2][_COLUMNS // 2] = "+"
    if box is not None:
        column = min(max(int(box.cx / size[0] * _COLUMNS), 0), _COLUMNS - 1)
        row = min(max(int(box.cy / size[1] * _ROWS), 0), _ROWS - 1)
        rows[row][column] = "O"
    lines = ["│" + "".join(row) + "│" for row in rows]
    edge = "─" * _COLUMNS
    return [f"┌{edge}┐", *lines, f"└{edge}┘", _gauge(setpoint)]


def _gauge(setpoint: VelocitySetpoint | None) -> str:
    """Return arrows below the picture that point the way of the turn."""
    yaw_deg = 0.0 if setpoint is None else math.degrees(setpoint.yaw_rate_rad_s)
    length = min(_COLUMNS // 2, round(abs(yaw_deg) / 3))
    left = ("◄" * length if yaw_deg < 0 else "").rjust(_COLUMNS // 2)
    right = "►" * length if yaw_deg > 0 else ""
    return f" {left}|{right}"


def movers(mount: CameraMount) -> tuple[str, str]:
    """Return which turn of the body moves the image across, and which one moves it down."""
    axes = {"roll": (1.0, 0.0, 0.0), "pitch": (0.0, 1.0, 0.0), "yaw": (0.0, 0.0, 1.0)}
    right, down, _ = mount.camera_to_body.T
    # Turning about the camera's down axis moves the image across, about its right axis, down.
    across = max(axes, key=lambda name: abs(float(down @ axes[name])))
    along = max(axes, key=lambda name: abs(float(right @ axes[name])))
    return across, along


def progress(judgement: Judgement, mount: CameraMount) -> list[str]:
    """Return for each direction what is known, or what is to be done."""
    across, down = movers(mount)
    rows = (
        ("across", judgement.across, judgement.share_across, judgement.gain_across, across),
        ("up and down", judgement.down, judgement.share_down, judgement.gain_down, down),
    )
    lines = []
    for name, sign, share, gain, mover in rows:
        if sign is Sign.WAITING:
            lines.append(f"{name}: {_MOVES[mover]} ({share:.0%})")
        elif sign is Sign.RIGHT:
            remark = gain_remark(gain)
            lines.append(f"{name}: agrees with the attitude" + (f"; {remark}" if remark else ""))
        else:
            lines.append(f"{name}: {sign}")
    if judgement.attitude_stands:
        lines.append(
            "the image moves and the attitude does not: move the vehicle, not the target; if you "
            "do, this is not that vehicle's autopilot"
        )
    return lines


def diagnosis(judgement: Judgement) -> str:
    """Return what is wrong with the camera and what to set, "" if nothing is known to be."""
    signs = judgement.across, judgement.down
    if not judgement.is_wrong:
        return ""
    known: Sequence[tuple[tuple[Sign, Sign], str]] = (
        (
            (Sign.REVERSED, Sign.RIGHT),
            "the image is mirrored left to right: switch off mirroring in the camera or its driver",
        ),
        (
            (Sign.RIGHT, Sign.REVERSED),
            "up and down are exchanged: switch off flipping in the camera, or the camera looks "
            "backwards (camera.yaw_deg: 180)",
        ),
        (
            (Sign.REVERSED, Sign.REVERSED),
            "the camera is upside down: add 180 to camera.roll_deg",
        ),
        (
            (Sign.TURNED_RIGHT, Sign.TURNED_RIGHT),
            "the image is turned a quarter clockwise: subtract 90 from camera.roll_deg",
        ),
        (
            (Sign.TURNED_LEFT, Sign.TURNED_LEFT),
            "the image is turned a quarter anticlockwise: add 90 to camera.roll_deg",
        ),
    )
    for pattern, text in known:
        if signs == pattern:
            return text
    if Sign.WAITING in signs and any(sign.is_wrong for sign in signs):
        return "one direction is wrong; make the other movement, too, to find out how"
    return (
        "the image does not move as the attitude says: does the target stand still, is it far "
        "enough (5 m), are camera.pitch_deg, yaw_deg and roll_deg right?"
    )
