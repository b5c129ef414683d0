"""Variants in which something comes before or beside the target, or the light is bad."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import numpy.typing as npt

from failures.clip import Clip
from failures.windows import picked
from follower_vision.geometry.box import Box
from follower_vision.images.crop import crop
from follower_vision.images.frame import Image

_POST_EVERY, _POST_FIRST, _POST_REACH, _HIDDEN_FRAMES = 45, 25, 40, 10
_TWIN_PERIOD = 70
_OTHER_POSE = 12
_PLAYERS = 4
_BESIDE_WIDTHS, _BESIDE_FRAMES, _PARTING_PERIOD = 0.6, 40, 75
_BLACK = (0.0, 0.0, 0.0)


def occluded(clip: Clip, rng: np.random.Generator) -> Clip:  # noqa: ARG001
    """Slide a textured post over the target, which it hides for some ten frames each time."""
    clip = picked(clip, range(len(clip)))
    posts = [
        (when, box)
        for when in range(_POST_FIRST, len(clip) - 20, _POST_EVERY)
        if (box := clip.truth[when]) is not None
    ]

    def picture(number: int) -> Image:
        image = clip.picture(number)
        for when, box in posts:
            if abs(number - when) <= _POST_REACH:
                _put_post(image, clip.picture(when), _post(number, when, box), box)
        return image

    hidden = [
        number
        for number, box in enumerate(clip.truth)
        if box and any(_covers(_post(number, when, place), box) for when, place in posts)
    ]
    return _changed(clip, picture, frozenset(hidden))


def twin(clip: Clip, rng: np.random.Generator) -> Clip:
    """Let the target's mirror image cross it again and again, in turn behind and before it."""
    clip = picked(clip, range(len(clip)))
    slope = rng.uniform(-0.3, 0.3)

    def picture(number: int) -> Image:
        image, box = clip.picture(number), clip.truth[number]
        if box is None:
            return image
        crossing, phase = divmod(number, _TWIN_PERIOD)
        along = (2 * phase / _TWIN_PERIOD - 1) * (1 if crossing % 2 == 0 else -1)
        right = 4 * along * max(box.width, 20)
        place = box.moved_to(box.cx + right, box.cy + (0.15 + slope * along) * box.height)
        mirrored = _cut(image, box)[:, ::-1]
        _paste(image, mirrored, place, box if crossing % 2 == 0 else None)
        return image

    return _changed(clip, picture)


def team(clip: Clip, rng: np.random.Generator) -> Clip:
    """Let four copies of the target, in another pose, run about it at random."""
    clip = picked(clip, range(len(clip)))
    phases = rng.uniform(0, 2 * np.pi, (_PLAYERS, 2))
    speeds = rng.uniform(0.04, 0.09, (_PLAYERS, 2))

    def picture(number: int) -> Image:
        image, box = clip.picture(number), clip.truth[number]
        if box is None:
            return image
        copy = _another_pose(clip, number)
        ways = np.sin(phases + speeds * number) * (4.5 * max(box.width, 20), 0.6 * box.height)
        for player, (right, down) in enumerate(ways):
            place = box.moved_to(box.cx + right, box.cy + down)
            _paste(image, copy, place, box if player % 2 == 0 else None)
        return image

    return _changed(clip, picture)


def merged(clip: Clip, rng: np.random.Generator) -> Clip:
    """Let a neighbour of another colour come, go beside the target half hidden, and leave."""
    clip = picked(clip, range(len(clip)))
    shift = int(rng.integers(30, 150))

    def picture(number: int) -> Image:
        image, box = clip.picture(number), clip.truth[number]
        if box is None:
            return image
        turn, phase = divmod(number, _PARTING_PERIOD)
        away = max(0, abs(phase - _PARTING_PERIOD // 2) - _BESIDE_FRAMES // 2)
        right = (_BESIDE_WIDTHS + 0.15 * away) * max(box.width, 8) * (1 if turn % 2 == 0 else -1)
        neighbour = _recoloured(_another_pose(clip, number), shift)
        place = box.moved_to(box.cx + right, box.cy + 0.03 * box.height)
        _paste(image, neighbour, place, box)
        return image

    return _changed(clip, picture)


def blurred(clip: Clip, rng: np.random.Generator) -> Clip:
    """Blur half of the frames by motion, by up to 0.6 target sizes."""
    clip = picked(clip, range(len(clip)))
    angles = rng.uniform(0, np.pi, len(clip))

    def picture(number: int) -> Image:
        length = 0.6 * clip.start.scale * max(0.0, float(np.sin(number * 0.3)))
        return _smeared(clip.picture(number), length, angles[number - number % 10])

    return _changed(clip, picture)


def dim(clip: Clip, rng: np.random.Generator) -> Clip:
    """Show a third of the light, flickering, with the noise of a dark scene."""
    clip = picked(clip, range(len(clip)))
    gains = 0.35 * np.exp(rng.normal(0, 0.2, len(clip)))
    seeds = rng.integers(0, 2**32, len(clip))

    def picture(number: int) -> Image:
        image = clip.picture(number)
        noise = np.random.default_rng(seeds[number]).normal(0, 4, image.shape[:2])
        dark = image * gains[number] + noise[..., None]
        return np.asarray(dark.clip(0, 255), np.uint8)

    return _changed(clip, picture)


def _changed(
    clip: Clip, picture: Callable[[int], Image], hidden: frozenset[int] = frozenset()
) -> Clip:
    return Clip(clip.name, clip.truth, picture, clip.size, clip.rate_hz, hidden)


def _post(number: int, when: int, box: Box) -> tuple[float, float]:
    """The post's left and right side in a frame; it stands over the box in frame `when`."""
    width = 2.0 * max(box.width, 0.6 * box.height)
    way = 1 if (when - _POST_FIRST) // _POST_EVERY % 2 == 0 else -1
    centre = box.cx + way * (number - when) * (width - box.width) / _HIDDEN_FRAMES
    return centre - width / 2, centre + width / 2


def _covers(post: tuple[float, float], box: Box) -> bool:
    return post[0] <= box.left + 0.1 * box.width and box.right - 0.1 * box.width <= post[1]


def _put_post(image: Image, source: Image, sides: tuple[float, float], box: Box) -> None:
    """Paint a strip of the scene, upside down, as a post."""
    wide = image.shape[1]
    left, right = max(0, int(sides[0])), min(wide, int(sides[1]))
    breadth = int(sides[1] - sides[0])
    origin = 0 if box.left > wide / 2 else max(0, wide - breadth - 1)
    skipped = left - int(sides[0])
    strip = source[::-1, origin + skipped : origin + skipped + right - left]
    if right - left >= 2 and strip.shape[1] == right - left:
        image[:, left:right] = strip


def _another_pose(clip: Clip, number: int) -> Image:
    """The target as it looked some frames ago, or will, at its present size."""
    other = number - _OTHER_POSE if number >= _OTHER_POSE else number + _OTHER_POSE
    box, now = clip.truth[min(other, len(clip) - 1)], clip.truth[number]
    if box is None or now is None:
        other, box = 0, clip.start
    patch = _cut(clip.picture(min(other, len(clip) - 1)), box)
    size = patch.shape[:2] if now is None else (max(3, int(now.height)), max(3, int(now.width)))
    return np.asarray(cv2.resize(patch, (size[1], size[0])), np.uint8)


def _cut(image: Image, box: Box) -> Image:
    return crop(image, box, max(3, int(box.width)), max(3, int(box.height)), _BLACK)


def _paste(image: Image, patch: Image, place: Box, before: Box | None) -> None:
    """Blend a patch in, its edges soft; behind what a box holds, if one is given."""
    high, wide = patch.shape[:2]
    left, top = round(place.cx - wide / 2), round(place.cy - high / 2)
    x0, y0 = max(0, left), max(0, top)
    x1, y1 = min(image.shape[1], left + wide), min(image.shape[0], top + high)
    if x1 - x0 < 2 or y1 - y0 < 2:
        return
    cut = slice(y0 - top, y1 - top), slice(x0 - left, x1 - left)
    share = _soft(high, wide)[cut][..., None]
    if before is not None:
        share = share * (1 - _covered(before, x0, y0, x1, y1))[..., None]
    under = image[y0:y1, x0:x1]
    image[y0:y1, x0:x1] = (under * (1 - share) + patch[cut] * share).astype(np.uint8)


def _covered(box: Box, x0: int, y0: int, x1: int, y1: int) -> npt.NDArray[np.float64]:
    x = np.arange(x0, x1) + 0.5
    y = np.arange(y0, y1) + 0.5
    across = (x > box.left) & (x < box.right)
    down = (y > box.top) & (y < box.bottom)
    return np.outer(down, across).astype(float)


def _soft(high: int, wide: int) -> npt.NDArray[np.float64]:
    """A rounded mask, 0 to 1."""
    x = (np.arange(wide) + 0.5) / wide * 2 - 1
    y = (np.arange(high) + 0.5) / high * 2 - 1
    return np.clip((1.0 - (y[:, None] ** 4 + x[None, :] ** 4)) * 3, 0, 1)


def _recoloured(patch: Image, shift: int) -> Image:
    hsv = cv2.cvtColor(patch, cv2.COLOR_BGR2HSV)
    hsv[..., 0] = (hsv[..., 0].astype(int) + shift) % 180
    hsv[..., 1] = np.maximum(hsv[..., 1], 90)
    return np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR), np.uint8)


def _smeared(image: Image, length: float, angle: float) -> Image:
    reach = int(length / 2)
    if reach < 1:
        return image
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1), np.float32)
    right, down = round(reach * np.cos(angle)), round(reach * np.sin(angle))
    cv2.line(kernel, (reach - right, reach - down), (reach + right, reach + down), 1.0)
    return np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum()), np.uint8)
