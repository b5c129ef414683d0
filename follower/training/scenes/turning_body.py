"""Makes bodies that are seen from all sides: what is followed turns, and its outline with it."""

import math
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from follower.training.detector.random_scene import KINDS, random_colour
from follower.training.scenes.image_source import Cutout, ImageSource, TurningBody
from follower_sim.bodies.targets import target_mesh
from follower_sim.view import CameraView
from follower_sim.world.painter import LensProjection, SolidBatch, SolidPainter
from follower_sim.world.solid import Solid
from follower_vision.geometry.camera_model import CameraModel

_VIEWS = 24
_CANVAS_PX, _TEXTURE_PX = 96, 48
_FOV = math.radians(30.0)
_ROOM = 1.06
_STRIDE_M, _STRIDE_VIEWS = 1.5, 4
_AMBIENT, _SUNLIT = 0.6, 1.05
_EDGE_ON = 0.02
_SIDES = ((0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1))
"""A cuboid's faces: along which axis their normal is, and its sign."""
_ACROSS = ((1, 2), (0, 2), (0, 1))
"""The axes that a face spans, by its normal's."""

_TO_NED = (1.0, 1.0, -1.0)
"""The simulator's world counts down, bodies and blocks count up."""

Vector = npt.NDArray[np.float64]
Texture = npt.NDArray[np.uint8]


def simulated_body(rng: np.random.Generator) -> TurningBody:
    """Return one of the simulator's targets in some paint and sunlight; most persons walk."""
    kind = KINDS[int(rng.integers(len(KINDS)))]
    colour, elevation = random_colour(rng), float(rng.uniform(0.05, 1.1))
    sun = _towards(rng.uniform(-math.pi, math.pi), rng.uniform(0.3, 1.2)) * _TO_NED
    walks = kind == "person" and rng.random() < 0.8
    poses = range(_STRIDE_VIEWS if walks else 1)
    meshes = [target_mesh(kind, colour, _STRIDE_M * pose / _STRIDE_VIEWS) for pose in poses]
    solids = [Solid.placed(mesh, np.zeros(3), np.eye(3), sun) for mesh in meshes]
    painter = SolidPainter(LensProjection(CameraModel.from_fov(_CANVAS_PX, _CANVAS_PX, _FOV)))
    centre, away_m = solids[0].centre, _ROOM * solids[0].radius_m / math.sin(_FOV / 2)
    views = []
    for number, heading in enumerate(_headings()):
        place = centre + away_m * _towards(heading, elevation) * _TO_NED
        view = CameraView.towards(place, centre)
        faces = painter.select([SolidBatch.of([solids[number % len(solids)]])], view)
        on_black, on_white = (
            np.full((_CANVAS_PX, _CANVAS_PX, 3), ground, np.uint8) for ground in (0, 255)
        )
        for image in (on_black, on_white):
            painter.paint(image, faces, view)
        # Of soft edges both pictures are rounded, so that a colour may exceed its mask by a little.
        mask = 255 - (on_white.astype(np.int16) - on_black).max(axis=2, keepdims=True).clip(0, 255)
        canvas = np.dstack([np.minimum(on_black, mask), mask]).astype(np.uint8)
        views.append(Cutout.premultiplied(canvas))
    return TurningBody(tuple(views))


class _Block(NamedTuple):
    """A cuboid: its middle and half its sides, (3,) each, and a texture for each face."""

    middle: Vector
    half: Vector
    textures: tuple[Texture, ...]


def block_body(rng: np.random.Generator, pictures: ImageSource) -> TurningBody:
    """Return one to three cuboids with faces of photographs, one upon or beside the other."""
    blocks = [_Block(np.zeros(3), np.exp(rng.normal(0.0, 0.45, 3)), _textures(rng, pictures))]
    for _ in range(int(rng.integers(0, 3))):
        other = blocks[int(rng.integers(len(blocks)))]
        half = other.half * rng.uniform(0.3, 1.0, 3)
        side = np.eye(3)[2 if rng.random() < 0.6 else int(rng.integers(2))]
        slide = (1 - side) * rng.uniform(-1, 1, 3) * np.maximum(other.half - half, 0)
        middle = other.middle + side * (other.half + half) + slide
        textures = other.textures if rng.random() < 0.4 else _textures(rng, pictures)
        blocks.append(_Block(middle, half, textures))
    low = np.min([block.middle - block.half for block in blocks], axis=0)
    high = np.max([block.middle + block.half for block in blocks], axis=0)
    scale = _CANVAS_PX / (_ROOM * float(np.linalg.norm(high - low)))
    centred = [block._replace(middle=block.middle - (low + high) / 2) for block in blocks]
    elevation, light = float(rng.uniform(0.0, 1.2)), rng.normal(size=3)
    light /= np.linalg.norm(light)
    drawn = (_drawn(centred, scale, heading, elevation, light) for heading in _headings())
    return TurningBody(tuple(map(Cutout.premultiplied, drawn)))


def _headings() -> list[float]:
    return [2 * math.pi * number / _VIEWS for number in range(_VIEWS)]


def _towards(heading: float, elevation: float) -> Vector:
    """Return the unit vector, z up, from a body to where it is seen from."""
    level = math.cos(elevation)
    return np.array([level * math.cos(heading), level * math.sin(heading), math.sin(elevation)])


def _textures(rng: np.random.Generator, pictures: ImageSource) -> tuple[Texture, ...]:
    """Return six faces: opposite ones mostly alike, often of one paint, some rounded."""
    paint, plain = rng.uniform(0, 255, 3), rng.uniform(0, 1)
    rounded = bool(rng.random() < 0.5)
    faces: list[Texture] = []
    for _ in range(3):
        first = _face(rng, pictures, paint, plain, rounded)
        alike = rng.random() < 0.6
        faces += [first, first if alike else _face(rng, pictures, paint, plain, rounded)]
    return tuple(faces)


def _face(
    rng: np.random.Generator, pictures: ImageSource, paint: Vector, plain: float, rounded: bool
) -> Texture:
    """Return (48, 48, 4): a piece of a photograph under paint, with a mask."""
    ground = pictures.any_ground(rng)
    side = int(rng.integers(_TEXTURE_PX // 2, min(ground.shape[:2]) // 2))
    left, top = (int(rng.integers(length - side + 1)) for length in ground.shape[1::-1])
    piece = ground[top : top + side, left : left + side]
    size = (_TEXTURE_PX, _TEXTURE_PX)
    picture = plain * paint + (1 - plain) * cv2.resize(piece, size, interpolation=cv2.INTER_AREA)
    if rng.random() < 0.4:  # a pane, a door, a stripe
        (left, top), (right, bottom) = np.sort(rng.integers(4, _TEXTURE_PX - 4, (2, 2)), axis=0)
        picture[top : bottom + 1, left : right + 1] = rng.uniform(0, 255, 3)
    corner = int(rng.integers(4, _TEXTURE_PX // 2 - 1)) if rounded else 0
    mask = _rounded(corner)
    return np.dstack([np.clip(picture, 0, 255), mask]).astype(np.uint8)


def _rounded(corner: int) -> npt.NDArray[np.uint8]:
    """Return a mask (48, 48) whose corners are quarters of circles of a radius in pixels."""
    mask = np.zeros((_TEXTURE_PX, _TEXTURE_PX), np.uint8)
    inner, last = slice(corner, _TEXTURE_PX - corner), _TEXTURE_PX - 1 - corner
    mask[inner, :] = mask[:, inner] = 255
    for middle in ((corner, corner), (corner, last), (last, corner), (last, last)):
        cv2.circle(mask, middle, corner, 255, cv2.FILLED)
    return mask


def _drawn(
    blocks: list[_Block], scale: float, heading: float, elevation: float, light: Vector
) -> Texture:
    """Draw blocks from afar, the farthest face first: (96, 96, 4), colours times mask."""
    towards = _towards(heading, elevation)
    right = np.array([-math.sin(heading), math.cos(heading), 0.0])
    to_canvas = scale * np.stack([right, -np.cross(towards, right)])
    canvas: npt.NDArray[np.floating] = np.zeros((_CANVAS_PX, _CANVAS_PX, 4), np.float32)
    corners_px = np.array([[0, 0], [_TEXTURE_PX, 0], [0, _TEXTURE_PX]], np.float32) - 0.5
    faces = []
    for block in blocks:
        for number, (axis, sign) in enumerate(_SIDES):
            if sign * towards[axis] > _EDGE_ON:
                centre = block.middle + sign * block.half[axis] * np.eye(3)[axis]
                faces.append((float(centre @ towards), number, block, centre))
    for _, number, block, centre in sorted(faces, key=lambda face: face[0]):
        axis, sign = _SIDES[number]
        across, down = (block.half[k] * np.eye(3)[k] for k in _ACROSS[axis])
        corners = np.array([-across + down, across + down, -across - down]) + centre
        on_canvas = corners @ to_canvas.T + _CANVAS_PX / 2 - 0.5
        matrix = cv2.getAffineTransform(corners_px, on_canvas.astype(np.float32))
        shade = _AMBIENT + (_SUNLIT - _AMBIENT) * max(0.0, float(sign * light[axis]))
        texture = block.textures[number].astype(np.float32)
        texture[:, :, :3] *= shade * texture[:, :, 3:] / 255
        face = cv2.warpAffine(texture, matrix, (_CANVAS_PX, _CANVAS_PX), flags=cv2.INTER_LINEAR)
        canvas = canvas * (1 - face[:, :, 3:] / 255) + face
    canvas[:, :, :3] = np.minimum(canvas[:, :, :3], canvas[:, :, 3:])
    return np.asarray(np.clip(canvas, 0, 255), dtype=np.uint8)
