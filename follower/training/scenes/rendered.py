"""Grounds and objects from the simulator's renderer: as many as wanted, and no file to fetch."""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from follower.training.detector.rendered import looking
from follower.training.detector.stage import StagedWorld, random_stage, random_world
from follower.training.scenes.cutout import Cutout
from follower.training.scenes.pictures import Pictures
from follower_sim.render import Renderer
from follower_sim.silhouettes import Silhouettes
from follower_sim.view import View
from follower_vision.box import Box
from follower_vision.camera import CameraModel
from follower_vision.frame import Image
from follower_vision.lineofsight import CameraMount

_WIDTH, _HEIGHT = 640, 480
_GROUNDS, _OBJECTS = 3, 6
_LEAST_PX, _MOST_PX = 24, 128
_LEAST_COVERAGE = 0.15
_DIFFERS = 10
_MOUNT = CameraMount()


def rendered(rng: np.random.Generator, worlds: int) -> Pictures:
    """Return pictures of so many worlds, each with other grounds, lights, plants and bodies."""
    photographs: list[Image] = []
    cutouts: list[Cutout] = []
    for _ in range(worlds):
        world = random_world(rng)
        camera = CameraModel.from_fov(_WIDTH, _HEIGHT, math.radians(float(rng.uniform(45, 95))))
        renderer = Renderer(world, camera, _MOUNT)
        silhouettes = Silhouettes(camera, world.scenery)
        for _ in range(_GROUNDS):
            world.stage = random_stage(world, rng)
            photographs.append(renderer.render(0.0, looking(world, rng)))
        found = (_object(world, renderer, silhouettes, rng) for _ in range(_OBJECTS))
        cutouts += [cutout for cutout in found if cutout is not None]
    return Pictures(tuple(photographs), (), tuple(cutouts))


def _object(
    world: StagedWorld, renderer: Renderer, silhouettes: Silhouettes, rng: np.random.Generator
) -> Cutout | None:
    """Cut out a body: what differs from the same picture without it. None if little is seen."""
    actor = random_stage(world, rng)[0]
    world.stage = (actor,)
    body = looking(world, rng)
    seen = silhouettes.seen(actor.solid, (), View.of(body, _MOUNT))
    if seen.box is None or seen.visible_share < 1.0 or seen.in_frame_share < 1.0:
        return None
    image = renderer.render(0.0, body)
    world.stage = ()
    return _cut(image, renderer.render(0.0, body), seen.box)


def _cut(image: Image, without: Image, box: Box) -> Cutout | None:
    left, top = math.floor(box.left), math.floor(box.top)
    rows, columns = slice(top, math.ceil(box.bottom)), slice(left, math.ceil(box.right))
    picture = image[rows, columns]
    if min(picture.shape[:2]) < _LEAST_PX:
        return None
    difference = cv2.absdiff(picture, without[rows, columns]).max(axis=2)
    mask = _largest(cv2.morphologyEx(_white(difference), cv2.MORPH_CLOSE, np.ones((5, 5))))
    if (mask > 0).mean() < _LEAST_COVERAGE:
        return None
    scale = min(1.0, _MOST_PX / max(picture.shape[:2]))
    cut = cv2.resize(
        np.dstack([picture, mask]), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA
    )
    return Cutout.of(np.asarray(cut, np.uint8))


def _white(difference: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    return np.where(difference > _DIFFERS, np.uint8(255), np.uint8(0))


def _largest(mask: cv2.typing.MatLike) -> npt.NDArray[np.uint8]:
    """Return a mask's largest connected part."""
    _, labels, facts, _ = cv2.connectedComponentsWithStats(mask)
    if len(facts) < 2:
        return np.zeros(mask.shape, np.uint8)
    part = 1 + int(facts[1:, cv2.CC_STAT_AREA].argmax())
    return np.where(labels == part, np.uint8(255), np.uint8(0))
