"""The camera's settings as `follower fly` and `follower track` read them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml

from follower.calibration.board import Board
from follower.calibration.solving import Calibration
from follower.settings import merged

_MOUNT = """\
# How the camera is mounted, and how late its pictures are, no calibration tells:
# camera.pitch_deg, roll_deg, yaw_deg, latency_s; see docs/fly.md.
"""


def camera_settings(calibration: Calibration) -> dict[str, Any]:
    """Return the section `camera` with what is known of the lens now."""
    lens = calibration.lens
    return {
        "focal_px": round(lens.fx, 3),
        "focal_width_px": lens.width,
        "center_px": [round(lens.cx, 3), round(lens.cy, 3)],
        "distortion": [round(number, 6) for number in lens.distortion],
        "frame_size": [lens.width, lens.height],
    }


def settings_yaml(
    calibration: Calibration, board: Board, source: str, known: Mapping[str, Any]
) -> str:
    """Return a settings file with the lens in it.

    Args:
        calibration: what came out.
        board: that was seen.
        source: of the images, for the comment.
        known: settings that go into it as they are, but for the lens.
    """
    square_mm = 1e3 * board.square_m
    head = (
        f"# A lens as `follower calibrate` found it with {len(calibration.views)} views of a "
        f"{board.kind} board\n# of {board.across} x {board.down} squares of {square_mm:g} mm, from "
        f"{source}.\n"
        f"# Corners lie {calibration.error_px:.2f} px from where they should be; the focal length "
        f"is good to {max(calibration.focal_doubt, 1e-4):.2%}.\n"
    )
    settings = merged(known, {"camera": camera_settings(calibration)})
    mounted = {"pitch_deg", "roll_deg", "yaw_deg", "latency_s"} & set(known.get("camera", {}))
    body = yaml.safe_dump(settings, sort_keys=False, default_flow_style=None)
    return head + ("" if mounted else _MOUNT) + str(body)
