"""Random scenes of the simulator: a world whose moving bodies change from picture to picture."""

import colorsys
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, get_args

import numpy as np
from pydantic import Field, PositiveInt
from pydantic.dataclasses import dataclass as settings

from follower.training.detector.labelled_image import (
    IGNORED,
    LabelledImage,
    distorted,
    mirrored,
    motion_blurred,
)
from follower.training.settings import STRICT
from follower_sim.bodies.mesh import Colour, Mesh, ball, box, prism, ring
from follower_sim.bodies.targets import TargetKind, target_mesh
from follower_sim.kinematics import BodyState, Triple
from follower_sim.scenario.scenario import Scenario
from follower_sim.view import CameraView
from follower_sim.world.render import Renderer
from follower_sim.world.silhouettes import Silhouettes
from follower_sim.world.solid import Solid
from follower_sim.world.world import World
from follower_vision.detection.families import YoloV2Decoder
from follower_vision.geometry.box import Box
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.geometry.line_of_sight import CameraMount, rotation
from follower_vision.images.crop import crop
from follower_vision.images.frame import Image

KINDS: tuple[TargetKind, ...] = get_args(TargetKind)
"""What is to be found, by class number."""

REACH_M = 26.0
_GROUNDS = ("meadow", "farmland", "desert", "water")
_CLUTTER = ("broadleaf", "fir", "house", "rock", "bale", "buoy")
_LAND_SHARES = {"person": 0.2, "car": 0.6, "boat": 0.02, "quadrotor": 0.18}
_WATER_SHARES = {"person": 0.04, "car": 0.04, "boat": 0.68, "quadrotor": 0.24}
_HIGHEST_M = 18.0
_LONGEST_TRIES = 20
_BESIDE_RADII = 1.5
_ROOM = 0.65
_PAINTS = 14
_STRIDE_STEPS = 12
_LEAST_VISIBLE = 0.4
_HIDDEN = 0.1
_RENDERED_SMALLEST_PX = 5.0
_FLYING_M = 4.0
MOUNT = CameraMount()
_WHOLE_SHARE = 0.25
_ANYWHERE_SHARE = 0.05
_ZOOM = (2.4, 8.0)
_LEAST_CROP_PX = 64.0
_LEAST_INSIDE = 0.5
_TRACE_INSIDE = 0.1
_SMALLEST_PX = 10.0


@dataclass(frozen=True, slots=True)
class Actor:
    """A body on the stage.

    Attributes:
        solid: as it stands in the world.
        kind: its class number; None for what is not to be found.
    """

    solid: Solid
    kind: int | None


class StagedWorld(World):
    """A world whose moving bodies are those put on the stage, whatever its paths say."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        super().__init__(scenario, seed)
        self.stage: Sequence[Actor] = ()
        rng = self._rng(20)
        self.paints = [random_colour(rng) for _ in range(_PAINTS)]

    def moving(self, time_s: float) -> list[Solid]:  # noqa: ARG002  the stage stands still
        """Return the bodies on the stage."""
        return [actor.solid for actor in self.stage]


class Studio:
    """A random world, and a random lens of 45 to 95 degrees to draw it with.

    Args:
        rng: the source of chance.
        width: of the pictures in pixels.
        height: likewise.
    """

    def __init__(self, rng: np.random.Generator, width: int, height: int) -> None:
        self.world = random_world(rng)
        camera = CameraModel.from_fov(width, height, math.radians(float(rng.uniform(45, 95))))
        self.renderer = Renderer(self.world, camera, MOUNT)
        self.silhouettes = Silhouettes(camera, self.world.scenery)


def random_world(rng: np.random.Generator) -> StagedWorld:
    """Return a world with another ground, sky, light and scenery each time."""
    ground = _GROUNDS[int(rng.choice(4, p=(0.3, 0.36, 0.12, 0.22)))]
    scenario = Scenario.model_validate(
        {
            "name": "training",
            "title": "A scene to learn from.",
            "duration_s": 1,
            "ground": {"kind": ground, "roads": [] if ground == "water" else _roads(rng)},
            "sky": {
                "sun_azimuth_deg": float(rng.uniform(0, 360)),
                "sun_elevation_deg": float(rng.uniform(12, 80)),
                "clouds": float(rng.uniform(0, 1)),
                "visibility_m": float(rng.uniform(250, 1500)),
            },
            "targets": [
                {"kind": "car", "colour": "#808080", "path": {"points": [[-14, 0], [14, 0]]}}
            ],
            "scatter": _scatter(ground, rng),
            "start": {"at": [0, 0]},
            "select": {"colour": "#808080"},
        }
    )
    return StagedWorld(scenario, int(rng.integers(1 << 31)))


def _roads(rng: np.random.Generator) -> list[dict[str, object]]:
    roads: list[dict[str, object]] = []
    for _ in range(int(rng.integers(0, 3))):
        turn, off = rng.uniform(0, math.pi), rng.uniform(-15, 15)
        along = np.array([math.cos(turn), math.sin(turn)])
        middle = off * np.array([-along[1], along[0]])
        bend = middle + rng.uniform(-6, 6, 2)
        points = [(middle - 60 * along).tolist(), bend.tolist(), (middle + 60 * along).tolist()]
        surface = "asphalt" if rng.random() < 0.7 else "dirt"
        width = float(rng.uniform(4, 9))
        roads.append({"points": points, "width_m": width, "surface": surface})
    return roads


def _scatter(ground: str, rng: np.random.Generator) -> list[dict[str, object]]:
    kinds = ("rock", "buoy") if ground == "water" else _CLUTTER
    chosen = [kind for kind in kinds if rng.random() < 0.6]
    most = {"house": 5, "broadleaf": 16, "fir": 16}
    return [
        {
            "kind": kind,
            "count": int(rng.integers(1, most.get(kind, 9) + 1)),
            "clear_m": 5.0 if kind == "house" else 2.0,
            "within_m": 32,
        }
        for kind in chosen
    ]


def random_stage(world: StagedWorld, rng: np.random.Generator) -> list[Actor]:
    """Return bodies at random places, clear of each other and of what stands."""
    shares = _WATER_SHARES if world.scenario.ground.kind == "water" else _LAND_SHARES
    weights = [shares[kind] for kind in KINDS]
    kind, paint = int(rng.choice(len(KINDS), p=weights)), _paint(world, rng)
    actors = [_placed(world, [], kind, paint, rng)]
    while rng.random() < 0.66 and len(actors) < 7:
        # Things of one kind keep company, and some are painted alike: look-alikes.
        again = rng.random() < 0.6
        kind = kind if again else int(rng.choice(len(KINDS), p=weights))
        paint = paint if again and rng.random() < 0.5 else _paint(world, rng)
        actors.append(_placed(world, actors, kind, paint, rng))
    for _ in range(int(rng.integers(0, 5))):
        actors.append(_placed(world, actors, None, paint, rng))
    return actors


def _paint(world: StagedWorld, rng: np.random.Generator) -> Colour:
    return world.paints[int(rng.integers(_PAINTS))]


def _placed(
    world: StagedWorld,
    others: Sequence[Actor],
    kind: int | None,
    paint: Colour,
    rng: np.random.Generator,
) -> Actor:
    """Return a body at a free place; half of them near one that is there already, or beside it."""
    mesh = _clutter(rng) if kind is None else _body(KINDS[kind], paint, rng)
    flying = kind is not None and KINDS[kind] == "quadrotor" and rng.random() < 0.8
    height = float(rng.uniform(0.5, _HIGHEST_M)) if flying else 0.0
    roll, pitch = rng.normal(0, 0.12, 2).tolist() if flying else (0.0, 0.0)
    turn = rotation(roll, pitch, float(rng.uniform(-math.pi, math.pi)))
    near = others[int(rng.integers(len(others)))].solid if others else None
    solid = Solid.placed(mesh, (0.0, 0.0, 0.0), turn, world.sun)
    for _ in range(_LONGEST_TRIES):
        at = rng.uniform(-REACH_M, REACH_M, 2)
        if near is not None and rng.random() < 0.5:
            spread_m = 5.0 if rng.random() < 0.5 else _BESIDE_RADII * near.radius_m
            at = near.centre[:2] + rng.normal(0, spread_m, 2)
        place: Triple = (float(at[0]), float(at[1]), -height)
        solid = Solid.placed(mesh, place, turn, world.sun)
        around = (*world.scenery, *(other.solid for other in others))
        if not any(_touch(solid, other) for other in around):
            break
    return Actor(solid, kind)


def _touch(solid: Solid, other: Solid) -> bool:
    room = _ROOM * (solid.radius_m + other.radius_m)
    return float(np.linalg.norm(solid.centre - other.centre)) < room


def _body(kind: TargetKind, colour: Colour, rng: np.random.Generator) -> Mesh:
    """Return a body in one of the world's paints; making one takes longer than drawing it."""
    walks = kind == "person" and rng.random() < 0.8
    travelled = 1.5 * int(rng.integers(_STRIDE_STEPS)) / _STRIDE_STEPS if walks else 0.0
    return _made(kind, colour, travelled)


_made = lru_cache(maxsize=600)(target_mesh)


def random_colour(rng: np.random.Generator) -> Colour:
    """Return a paint: any hue, or a grey as many cars have."""
    saturation = rng.uniform(0.35, 1.0) if rng.random() < 0.65 else rng.uniform(0, 0.15)
    light = rng.uniform(0.12, 0.95)
    red, green, blue = colorsys.hsv_to_rgb(rng.random(), saturation, light)
    return round(255 * blue), round(255 * green), round(255 * red)


def _clutter(rng: np.random.Generator) -> Mesh:
    """Return a thing of some paint that is of no class: a crate, a container, a drum, a ball."""
    colour, top, shape = random_colour(rng), random_colour(rng), int(rng.integers(4))
    if shape == 0:
        length, width, height = rng.uniform((0.3, 0.3, 0.2), (1.5, 1.5, 1.8))
        return box((length, width, height), colour, top=top)
    if shape == 1:
        length, width, height = rng.uniform((3, 1.8, 1.8), (7, 2.6, 2.8))
        return box((length, width, height), colour, top=top if rng.random() < 0.5 else None)
    radius, height = rng.uniform((0.1, 0.4), (0.9, 2.2))
    if shape == 2:
        return prism(ring(8, radius, 0), ring(8, radius, height), colour, top)
    return ball(radius, (0, 0, radius), colour)


def whole_view(picture: LabelledImage, side: int) -> LabelledImage:
    """Return the whole picture as the network sees it, `side` pixels square."""
    return cut_view(picture, _whole(picture), side)


def shown(picture: LabelledImage, side: int, rng: np.random.Generator) -> LabelledImage:
    """Return one view of a picture: the whole, a crop about one of its objects, or anywhere."""
    return cut_view(picture, _region(picture, rng), side)


def _whole(picture: LabelledImage) -> Box:
    height, width = picture.image.shape[:2]
    return Box(width / 2, height / 2, width, height)


def _region(picture: LabelledImage, rng: np.random.Generator) -> Box:
    whole, chance = _whole(picture), rng.random()
    if chance < _WHOLE_SHARE:
        return whole
    found = picture.boxes[picture.classes != IGNORED]
    if chance < _WHOLE_SHARE + _ANYWHERE_SHARE or not len(found):
        side = max(_LEAST_CROP_PX, whole.scale * float(rng.uniform(0.2, 0.7)))
        x, y = rng.uniform(0, 1, 2) * (whole.width, whole.height)
        return Box(float(x), float(y), side, side)
    left, top, right, bottom = found[int(rng.integers(len(found)))].tolist()
    zoom = float(np.exp(rng.uniform(*np.log(_ZOOM))))
    scale = math.sqrt((right - left) * (bottom - top))
    side = max(_LEAST_CROP_PX, zoom * scale, 1.15 * max(right - left, bottom - top))
    x, y = rng.uniform(-0.25, 0.25, 2) * side
    return Box((left + right) / 2 + float(x), (top + bottom) / 2 + float(y), side, side)


def cut_view(picture: LabelledImage, region: Box, side: int) -> LabelledImage:
    """Return a region of a picture as the network sees it, `side` pixels square.

    What the edge cuts is to be found if half of it is left; of less than a tenth nothing is said.
    """
    form = YoloV2Decoder.input_format
    view = form.view(region, side, side)
    image = crop(picture.image, view, side, side, [form.fill] * 3)
    scale = side / view.width
    corner = np.array([view.left, view.top] * 2, np.float32)
    moved = (picture.boxes - corner) * scale
    cut = np.clip(moved, *_limits(picture.image, view, scale)).astype(np.float32)
    inside = _areas(cut) / np.maximum(_areas(moved), 1e-9)
    large = (cut[:, 2:] - cut[:, :2]).max(axis=1, initial=0) >= _SMALLEST_PX
    classes = np.where((inside >= _LEAST_INSIDE) & large, picture.classes, IGNORED)
    kept = (inside >= _TRACE_INSIDE) & ((cut[:, 2:] - cut[:, :2]).min(axis=1, initial=9e9) > 0.5)
    return LabelledImage(image, cut[kept], classes[kept])


def _limits(image: Image, view: Box, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners, in the view's pixels, of what the view shows of the image."""
    height, width = image.shape[:2]
    low = (np.maximum((view.left, view.top), 0) - (view.left, view.top)) * scale
    high = (np.minimum((view.right, view.bottom), (width, height)) - (view.left, view.top)) * scale
    return np.tile(low, 2).astype(np.float32), np.tile(high, 2).astype(np.float32)


def _areas(corners: np.ndarray) -> np.ndarray:
    return np.asarray((corners[:, 2:] - corners[:, :2]).prod(axis=1))


@settings(frozen=True, slots=True, config=STRICT)
class RenderedPictures:
    """Scenes with car, person, boat and quadrotor among clutter.

    Each world gives several pictures with other bodies, places and lenses, and each of those
    several views: the whole picture as a search sees it, and crops as a validation does. A buffer
    mixes the views of some worlds.

    Attributes:
        width: of the rendered pictures, in pixels.
        height: likewise.
        pictures_a_world: rendered in one world.
        views_a_picture: cut from one rendered picture.
        mixed: how many views the buffer holds.
        shown_times: how often a view is shown in the mean; to make one takes longer than to learn
            from it.
    """

    width: Annotated[int, Field(ge=64)] = 640
    height: Annotated[int, Field(ge=64)] = 480
    pictures_a_world: PositiveInt = 50
    views_a_picture: PositiveInt = 5
    mixed: PositiveInt = 800
    shown_times: PositiveInt = 4

    @property
    def class_names(self) -> tuple[str, ...]:
        """The simulator's targets."""
        return tuple(KINDS)

    def training(self, side: int, seed: int) -> Iterator[LabelledImage]:
        """Return an endless stream of views; one seed, one stream."""
        rng = np.random.default_rng([seed, 1])
        views = self._views(side, rng)
        buffer: list[LabelledImage] = []
        for view in views:
            if len(buffer) < self.mixed:
                buffer.append(view)
            else:
                buffer[int(rng.integers(len(buffer)))] = view
            for _ in range(self.shown_times):
                chosen = buffer[int(rng.integers(len(buffer)))]
                yield chosen if rng.random() < 0.5 else mirrored(chosen)

    def held_out(self, side: int, count: int) -> list[LabelledImage]:
        """Return `count` views of worlds that no training's seed leads to."""
        rng = np.random.default_rng([0, 2])
        few = RenderedPictures(self.width, self.height, 10, self.views_a_picture)
        views = few._views(side, rng)
        return [next(views) for _ in range(count)]

    def _views(self, side: int, rng: np.random.Generator) -> Iterator[LabelledImage]:
        while True:
            studio = Studio(rng, self.width, self.height)
            for _ in range(self.pictures_a_world):
                picture = distorted(_picture(studio, rng), rng)
                for _ in range(self.views_a_picture):
                    yield shown(picture, side, rng)


def _picture(studio: Studio, rng: np.random.Generator) -> LabelledImage:
    studio.world.stage = random_stage(studio.world, rng)
    body = looking(studio.world, rng)
    image = _moved(studio.renderer.render(0.0, body), rng)
    found = list(_seen(studio, CameraView.of(body, MOUNT)))
    boxes = [(box.left, box.top, box.right, box.bottom) for box, _ in found]
    classes = np.array([kind for _, kind in found], np.intp)
    return LabelledImage(image, np.array(boxes, np.float32).reshape(-1, 4), classes)


def _seen(studio: Studio, view: CameraView) -> Iterator[tuple[Box, int]]:
    """Yield the boxes of what shows enough; `IGNORED` for what shows a little."""
    solids = [actor.solid for actor in studio.world.stage]
    for number, actor in enumerate(studio.world.stage):
        if actor.kind is None:
            continue
        others = [*solids[:number], *solids[number + 1 :]]
        seen = studio.silhouettes.seen(actor.solid, others, view)
        if seen.box is None or seen.visible_share < _HIDDEN or seen.in_frame_share <= 0:
            continue
        clear = (
            seen.visible_share >= _LEAST_VISIBLE and max(seen.box.xywh[2:]) >= _RENDERED_SMALLEST_PX
        )
        yield seen.box, actor.kind if clear else IGNORED


def looking(world: StagedWorld, rng: np.random.Generator) -> BodyState:
    """Return a camera in the air that looks somewhere near a body; one in ten straight down."""
    wanted = [actor.solid for actor in world.stage if actor.kind is not None]
    solid = wanted[int(rng.integers(len(wanted)))]
    centre, size = solid.centre, 2 * solid.radius_m
    away = size * float(np.exp(rng.uniform(math.log(1.6), math.log(9))))
    lowest = -0.5 if -centre[2] > _FLYING_M else math.asin(min(0.7, 1.2 / away))
    elevation = float(rng.uniform(lowest, 1.0)) if rng.random() < 0.9 else 1.45
    azimuth = float(rng.uniform(-math.pi, math.pi))
    level = away * math.cos(elevation)
    position = centre - np.array(
        [level * math.cos(azimuth), level * math.sin(azimuth), away * math.sin(elevation)]
    )
    position[2] = min(position[2], -1.2)
    ahead = centre - position
    pitch = math.atan2(-ahead[2], math.hypot(ahead[0], ahead[1])) + float(rng.normal(0, 0.12))
    attitude = (float(rng.normal(0, 0.1)), pitch, azimuth + float(rng.normal(0, 0.2)))
    place = (float(position[0]), float(position[1]), float(position[2]))
    return BodyState(0.0, place, attitude_rad=attitude)


def _moved(image: Image, rng: np.random.Generator) -> Image:
    """Blur one picture in four along a random direction, as a turning camera does."""
    if rng.random() > 0.25:
        return image
    length, angle = float(rng.uniform(2, 13)), float(rng.uniform(0, math.pi))
    return motion_blurred(image, length * np.array([math.cos(angle), math.sin(angle)]))
