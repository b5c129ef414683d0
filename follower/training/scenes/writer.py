"""Generated scenes as image folders that `follower evaluate` reads."""

from __future__ import annotations

from pathlib import Path

import cv2

from follower.training.scenes.scene import Scene
from follower_vision.box import Box

_QUALITY = 92
_LEAST_IN_FRAME = 0.3


def write_sequence(scene: Scene, folder: Path) -> None:
    """Write img/000001.jpg and so on, and groundtruth.txt with x, y, width, height a line.

    Where most of the target is outside the frame, its line is 0,0,0,0. The boxes are those that
    a user would draw, the hidden parts of the target included.
    """
    (folder / "img").mkdir(parents=True, exist_ok=True)
    lines = []
    for frame in range(scene.frames):
        path = folder / "img" / f"{frame + 1:06}.jpg"
        cv2.imwrite(str(path), scene.whole(frame).image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        lines.append(_line(scene.drawn_box(frame), scene))
    (folder / "groundtruth.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _line(box: Box, scene: Scene) -> str:
    if box.visible_share(scene.width, scene.height) < _LEAST_IN_FRAME:
        return "0,0,0,0"
    return ",".join(f"{value:.2f}" for value in box.xywh)
