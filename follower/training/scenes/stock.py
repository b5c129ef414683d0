"""Pictures made ready once: large files are slow to read, small ones are not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from follower.training.scenes.collage import collage
from follower.training.scenes.cutout import Cutout
from follower.training.scenes.pictures import Pictures, procedural
from follower_control.strict_yaml import SettingsError

MOST_CUTOUTS = 1500
COLLAGES = 40
_PHOTOGRAPH_PX = 1100
_CUTOUT_PX = 128
_LEAST_SIDE_PX = 32
_LEAST_COVERAGE = 0.15


def prepare(
    folder: Path,
    listing: Path,
    stock: Path,
    seed: int,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> None:
    """Copy what a listing names, made small, into a stock's folder: all of it or nothing.

    Args:
        folder: into which the packages were unpacked, by `dpkg -x PACKAGE.deb FOLDER`.
        listing: YAML with lists of glob patterns, `photographs` and `cutouts`.
        stock: the folder to make.
        seed: chooses which cut-outs to take if there are more than `MOST_CUTOUTS`.
        progress: called with the files read and all.

    Raises:
        SettingsError: the folder does not hold what the listing names.
    """
    named = yaml.safe_load(listing.read_text(encoding="utf-8"))
    photographs, cutouts = _paths(folder, named["photographs"]), _paths(folder, named["cutouts"])
    if not photographs or not cutouts:
        raise SettingsError(f"{folder}: no pictures of {listing.name} are there; see its head")
    order = np.random.default_rng(seed).permutation(len(cutouts))[:MOST_CUTOUTS]
    chosen = [cutouts[index] for index in order]
    total = len(photographs) + len(chosen)
    part = stock.with_name(f"{stock.name}.part")
    for kind, paths, shrink in (
        ("photographs", photographs, _small_photograph),
        ("cutouts", chosen, _small_cutout),
    ):
        (part / kind).mkdir(parents=True, exist_ok=True)
        for index, path in enumerate(paths):
            picture = shrink(path)
            if picture is not None:
                cv2.imwrite(str(part / kind / f"{index:05}.png"), picture)
            progress(index + 1 + (len(photographs) if kind == "cutouts" else 0), total)
    part.replace(stock)


def load(stock: Path, seed: int, collages: int = COLLAGES) -> Pictures:
    """Return a prepared stock with textures and collages added.

    Raises:
        SettingsError: it was not prepared.
    """
    rng = np.random.default_rng(seed)
    photographs = [_read(path, cv2.IMREAD_COLOR) for path in sorted(stock.glob("photographs/*"))]
    cutouts = [_read(path, cv2.IMREAD_UNCHANGED) for path in sorted(stock.glob("cutouts/*"))]
    if not photographs or not cutouts:
        raise SettingsError(f"{stock}: there are no prepared pictures")
    pictures = Pictures(
        tuple(photographs), procedural(rng).textures, tuple(map(Cutout.of, cutouts))
    )
    crowded = tuple(collage(rng, pictures) for _ in range(collages))
    return Pictures(pictures.photographs + crowded, pictures.textures, pictures.cutouts)


def load_any(stock: Path, seed: int) -> Pictures:
    """Return a prepared stock, or a procedural one where none was prepared."""
    return load(stock, seed) if stock.is_dir() else procedural(np.random.default_rng(seed))


def _paths(folder: Path, patterns: list[dict[str, str]]) -> list[Path]:
    return [path for entry in patterns for path in sorted(folder.glob(entry["files"]))]


def _read(path: Path, flags: int) -> npt.NDArray[np.uint8]:
    picture = cv2.imread(str(path), flags)
    if picture is None:
        raise SettingsError(f"{path}: cannot be read as a picture")
    return np.asarray(picture, dtype=np.uint8)


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
