"""Where scenes get their pictures: files made small once, and the simulator's renderer."""

import math
import shutil
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import yaml
from rich.progress import track

from follower.settings.settings import configs_folder
from follower.training.detector.labelled_image import read_picture
from follower.training.detector.random_scene import MOUNT, Studio, looking, random_stage
from follower.training.scenes.image_source import Cutout, ImageSource, procedural
from follower.training.scenes.turning_body import block_body, simulated_body
from follower_control.common.strict_config import SettingsError
from follower_sim.view import CameraView
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image

STOCK = "stock"
MOST_CUTOUTS = 1500
COLLAGES = 40
_COLLAGE_PX, _MARGIN_PX = 700, 50
_PHOTOGRAPH_PX, _CUTOUT_PX = 1100, 128
_LEAST_SIDE_PX, _LEAST_RENDERED_PX = 32, 24
_LEAST_COVERAGE = 0.15
_WIDTH, _HEIGHT = 640, 480
_GROUNDS, _OBJECTS = 3, 6
_DIFFERS = 10
_WORLDS, _BODIES = 5, 6
"""Separates the simulated worlds' random numbers from those of other things of the same seed."""


def collage(rng: np.random.Generator, stock: ImageSource) -> Image:
    """Return a ground (700, 700, 3) with 20 to 120 objects of the stock on it."""
    canvas = np.asarray(
        cv2.resize(stock.any_ground(rng), (_COLLAGE_PX, _COLLAGE_PX)), dtype=np.uint8
    )
    for _ in range(int(rng.integers(20, 120))):
        item = stock.any_object(rng)
        zoom, turn = np.exp(rng.uniform(-1.2, 0.5)), rng.uniform(0, 2 * np.pi)
        place = np.eye(3)
        place[0, :2] = zoom * np.cos(turn), -zoom * np.sin(turn)
        place[1, :2] = zoom * np.sin(turn), zoom * np.cos(turn)
        place[:2, 2] = rng.uniform(-_MARGIN_PX, _COLLAGE_PX, 2)
        canvas, _ = item.draw(canvas, place)
    return canvas


def prepare(folder: Path, stock: Path, seed: int, listing: Path | None = None) -> None:
    """Copy what a listing names, made small, into a stock's folder: all of it or nothing.

    Args:
        folder: into which the packages were unpacked, by `dpkg -x PACKAGE.deb FOLDER`.
        stock: the folder to make.
        seed: chooses which cut-outs to take if there are more than `MOST_CUTOUTS`.
        listing: YAML with lists of glob patterns, `photographs` and `cutouts`; None is the one of
            configs/train.

    Raises:
        SettingsError: the folder does not hold what the listing names.
    """
    listing = listing or configs_folder() / "train" / "pictures.yaml"
    named = yaml.safe_load(listing.read_text(encoding="utf-8"))
    photographs, cutouts = (
        [path for entry in named[kind] for path in sorted(folder.glob(entry["files"]))]
        for kind in ("photographs", "cutouts")
    )
    if not photographs or not cutouts:
        raise SettingsError(f"{folder}: no pictures of {listing.name} are there; see its head")
    order = np.random.default_rng(seed).permutation(len(cutouts))[:MOST_CUTOUTS]
    chosen = [cutouts[index] for index in order]
    part = stock.with_name(f"{stock.name}.part")
    shutil.rmtree(part, ignore_errors=True)  # what was interrupted may have been of other pictures
    jobs = [
        *((part / "photographs", path, _small_photograph) for path in photographs),
        *((part / "cutouts", path, _small_cutout) for path in chosen),
    ]
    shown = track(jobs, "pictures made small", transient=True)
    for index, (target, path, shrink) in enumerate(shown):
        target.mkdir(parents=True, exist_ok=True)
        picture = shrink(path)
        if picture is not None:
            cv2.imwrite(str(target / f"{index:05}.png"), picture)
    shutil.rmtree(stock, ignore_errors=True)
    part.replace(stock)


def load(stock: Path, seed: int, collages: int = COLLAGES) -> ImageSource:
    """Return a prepared stock with textures and collages added.

    Raises:
        SettingsError: it was not prepared.
    """
    rng = np.random.default_rng(seed)
    photographs = [read_picture(path) for path in sorted(stock.glob("photographs/*"))]
    cutouts = [read_picture(path, cv2.IMREAD_UNCHANGED) for path in sorted(stock.glob("cutouts/*"))]
    if not photographs or not cutouts:
        raise SettingsError(f"{stock}: there are no prepared pictures")
    pictures = ImageSource(
        tuple(photographs), procedural(rng).textures, tuple(map(Cutout.of, cutouts))
    )
    crowded = tuple(collage(rng, pictures) for _ in range(collages))
    return ImageSource(pictures.photographs + crowded, pictures.textures, pictures.cutouts)


def image_source(
    pictures: Path | None,
    folder: Path,
    seed: int,
    worlds: int,
    bodies: int = 0,
    resume: bool = False,
) -> ImageSource:
    """Return what the scenes of a training are made of: its stock, if any, and rendered pictures.

    Args:
        pictures: see `prepare`; the stock is made of them.
        folder: of the training.
        seed: of the training.
        worlds: of the simulator, whose views and bodies join the pictures.
        bodies: seen from all sides, half of the simulator's kinds, half of blocks.
        resume: take the stock as it is, if there is one.

    Raises:
        SettingsError: see `prepare`.
    """
    stock = folder / STOCK
    if pictures is not None and not (resume and stock.is_dir()):
        prepare(pictures, stock, seed)
    source = load(stock, seed) if stock.is_dir() else procedural(np.random.default_rng(seed))
    source = source.joined(rendered(np.random.default_rng((seed, _WORLDS)), worlds))
    rng = np.random.default_rng((seed, _BODIES))
    turning = [
        simulated_body(rng) if number % 2 else block_body(rng, source) for number in range(bodies)
    ]
    return source.joined(ImageSource((), (), (), tuple(turning)))


def _small_photograph(path: Path) -> npt.NDArray[np.uint8] | None:
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    return None if picture is None else _shrunk(np.asarray(picture, np.uint8), _PHOTOGRAPH_PX)


def _small_cutout(path: Path) -> npt.NDArray[np.uint8] | None:
    """Load a picture with a mask; None if it is too small, too thin or has no mask."""
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if picture is None or picture.ndim != 3 or picture.shape[2] != 4 or picture.dtype != np.uint8:
        return None
    picture = _trimmed(np.asarray(picture, dtype=np.uint8))
    if min(picture.shape[:2]) < _LEAST_SIDE_PX:
        return None
    small = _shrunk(picture, _CUTOUT_PX)
    coverage = float((small[:, :, 3] > 127).mean())
    thin = min(small.shape[:2]) < _LEAST_SIDE_PX // 2
    return None if thin or coverage < _LEAST_COVERAGE else small


def _shrunk(picture: npt.NDArray[np.uint8], most_px: int) -> npt.NDArray[np.uint8]:
    scale = min(1.0, most_px / max(picture.shape[:2]))
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8)


def _trimmed(picture: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    solid = cv2.findNonZero((picture[:, :, 3] > 127).astype(np.uint8))
    if solid is None:
        return picture[:0]
    left, top, width, height = cv2.boundingRect(solid)
    return picture[top : top + height, left : left + width]


def rendered(rng: np.random.Generator, worlds: int) -> ImageSource:
    """Return pictures of so many worlds, each with other grounds, lights, plants and bodies."""
    photographs: list[Image] = []
    cutouts: list[Cutout] = []
    for _ in range(worlds):
        studio = Studio(rng, _WIDTH, _HEIGHT)
        for _ in range(_GROUNDS):
            studio.world.stage = random_stage(studio.world, rng)
            photographs.append(studio.renderer.render(0.0, looking(studio.world, rng)))
        found = (_object(studio, rng) for _ in range(_OBJECTS))
        cutouts += [cutout for cutout in found if cutout is not None]
    return ImageSource(tuple(photographs), (), tuple(cutouts))


def _object(studio: Studio, rng: np.random.Generator) -> Cutout | None:
    """Cut out a body: what differs from the same picture without it. None if little is seen."""
    world = studio.world
    actor = random_stage(world, rng)[0]
    world.stage = (actor,)
    body = looking(world, rng)
    seen = studio.silhouettes.seen(actor.solid, (), CameraView.of(body, MOUNT))
    if seen.box is None or seen.visible_share < 1.0 or seen.in_frame_share < 1.0:
        return None
    image = studio.renderer.render(0.0, body)
    world.stage = ()
    return _cut(image, studio.renderer.render(0.0, body), seen.box)


def _cut(image: Image, without: Image, box: Box) -> Cutout | None:
    left, top = math.floor(box.left), math.floor(box.top)
    rows, columns = slice(top, math.ceil(box.bottom)), slice(left, math.ceil(box.right))
    picture = image[rows, columns]
    if min(picture.shape[:2]) < _LEAST_RENDERED_PX:
        return None
    difference = cv2.absdiff(picture, without[rows, columns]).max(axis=2)
    changed = np.where(difference > _DIFFERS, np.uint8(255), np.uint8(0))
    mask = _largest(cv2.morphologyEx(changed, cv2.MORPH_CLOSE, np.ones((5, 5))))
    if (mask > 0).mean() < _LEAST_COVERAGE:
        return None
    return Cutout.of(_shrunk(np.dstack([picture, mask]).astype(np.uint8), _CUTOUT_PX))


def _largest(mask: cv2.typing.MatLike) -> npt.NDArray[np.uint8]:
    """Return a mask's largest connected part."""
    _, labels, facts, _ = cv2.connectedComponentsWithStats(mask)
    if len(facts) < 2:
        return np.zeros(mask.shape, np.uint8)
    part = 1 + int(facts[1:, cv2.CC_STAT_AREA].argmax())
    return np.where(labels == part, np.uint8(255), np.uint8(0))
