"""`follower train detector`: from a configuration to an ONNX file."""

from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import torch
import typer

from follower.training.detector.dataset import FolderPictures
from follower.training.detector.export import (
    export_detector,
    is_worth_it,
    measure_files,
    write_detector_card,
    write_eight_bit,
)
from follower.training.detector.labelled_image import (
    IGNORED,
    LabelledImage,
    TrainingImages,
)
from follower.training.detector.loss import find_anchors
from follower.training.detector.network import state_of_onnx
from follower.training.detector.settings import DetectorConfig
from follower.training.detector.trainer import DetectorTrainer, as_tensor
from follower.training.onnx_export import ExportedNetwork
from follower.training.trainer import SAMPLES, load_checkpoint, open_folder, train
from follower_vision.detection.families import YOLOV2_STRIDE
from follower_vision.images.frame import Image

DETECTIONS = "detections.png"
_TRUE, _FOUND, _LEFT_OUT = (80, 220, 60), (60, 170, 255), (150, 150, 150)
_TILE_PX = 224
_COLUMNS = 8
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_SHEET_PICTURES = 40
_SHOWN_SCORE = 0.3
_RANGE_PICTURES = 120


def train_detector(
    config: DetectorConfig,
    folder: Path,
    device: torch.device,
    resume: bool = False,
    start: Path | None = None,
) -> ExportedNetwork:
    """Train, measure and export.

    Args:
        config: what is trained.
        folder: where everything is written.
        device: where it computes.
        resume: go on from the folder's checkpoint.
        start: the folder of another training, or the network (.onnx) that one has written, whose
            weights and anchors this one begins with.

    Raises:
        SettingsError: the data or the checkpoint cannot be used.
    """
    state = open_folder(config, config.training, folder, device, resume)
    pictures: TrainingImages = config.rendered
    if config.data is not None:
        pictures = FolderPictures(config.data, config.folder, config.seed)
    shown = _some(config, pictures, _RANGE_PICTURES)
    begin = None
    if start is not None and start.suffix == ".onnx":
        sample = as_tensor(shown, torch.device("cpu"))
        begin = state_of_onnx(start, config.training, pictures.class_names, sample)
    elif start is not None:
        begin = load_checkpoint(start, device)
    known = state or begin
    anchors = None if known is None else np.array(known["anchors"])
    if state is None or anchors is None:
        anchors = _show_samples(config, pictures, folder, anchors)
    trainer = DetectorTrainer(config.training, pictures, anchors, config.seed, device)
    if state is not None:
        trainer.restore(state)
    elif begin is not None:
        trainer.begin_with(begin)
    train(trainer, folder)
    exported = export_detector(trainer, folder / f"{config.name}.onnx")
    write_detector_card(exported, trainer, config, trainer.measure(trainer.held_out))
    if trainer.held_out:
        cv2.imwrite(str(folder / DETECTIONS), _found_sheet(trainer))
        _try_eight_bit(exported.path, shown, trainer)
    return exported


def _some(config: DetectorConfig, pictures: TrainingImages, count: int) -> list[LabelledImage]:
    return list(islice(pictures.training(config.training.side_px, config.seed), count))


def _show_samples(
    config: DetectorConfig,
    pictures: TrainingImages,
    folder: Path,
    anchors: np.ndarray | None,
) -> np.ndarray:
    """Draw some of the pictures; return the anchors, if none are given those that fit best."""
    some = _some(config, pictures, max(config.training.anchor_pictures, _SHEET_PICTURES))
    tiles = [_with_truth(picture, pictures.class_names) for picture in some[:_SHEET_PICTURES]]
    path = folder / SAMPLES
    cv2.imwrite(str(path), _sheet(tiles))
    wanted = [one.boxes[one.classes != IGNORED] for one in some]
    corners = np.concatenate([*wanted, np.empty((0, 4), np.float32)]).astype(np.float64)
    sizes = (corners[:, 2:] - corners[:, :2]) / YOLOV2_STRIDE
    if anchors is None:
        anchors = find_anchors(sizes, config.training.anchors, config.seed)
    typer.echo(f"{path}: look at it.")
    return anchors


def _try_eight_bit(path: Path, shown: Sequence[LabelledImage], trainer: DetectorTrainer) -> None:
    """Write NAME-int8.onnx, report what it is worth, and keep it if it is worth it."""
    out = path.with_name(f"{path.stem}-int8.onnx")
    write_eight_bit(path, shown, out)
    trained, eight_bit = measure_files([path, out], trainer, trainer.held_out)
    kept = is_worth_it(eight_bit, trained)
    result = str(out) if kept else "not kept"
    typer.echo(f"in 8 bits: {eight_bit}; as trained: {trained}: {result}")
    if not kept:
        out.unlink()


def _found_sheet(trainer: DetectorTrainer) -> Image:
    """Return held-out pictures with the true boxes in green and those found in orange."""
    names, pictures = trainer.class_names, trainer.held_out[:_SHEET_PICTURES]
    tiles = []
    for picture, answer in zip(pictures, trainer.answers(pictures), strict=True):
        tile = _with_truth(picture, [""] * len(names))
        found = trainer.reader.read(answer, _SHOWN_SCORE)
        for corners, score, kind in zip(found.corners, found.scores, found.classes, strict=True):
            _draw(tile, corners, _FOUND, f"{names[kind]} {score:.2f}")
        tiles.append(tile)
    return _sheet(tiles)


def _with_truth(picture: LabelledImage, names: Sequence[str]) -> Image:
    tile = picture.image.copy()
    for corners, kind in zip(picture.boxes, picture.classes.tolist(), strict=True):
        ignored = kind == IGNORED
        _draw(tile, corners, _LEFT_OUT if ignored else _TRUE, "" if ignored else names[kind])
    return tile


def _draw(tile: Image, corners: np.ndarray, colour: tuple[int, int, int], label: str) -> None:
    left, top, right, bottom = (round(float(value)) for value in corners)
    cv2.rectangle(tile, (left, top), (right, bottom), colour, 1, cv2.LINE_AA)
    at = (max(left, 0) + 2, max(top - 4, 11))
    cv2.putText(tile, label, at, _FONT, 0.4, (20, 20, 20), 3, cv2.LINE_AA)
    cv2.putText(tile, label, at, _FONT, 0.4, colour, 1, cv2.LINE_AA)


def _sheet(tiles: Sequence[Image]) -> Image:
    size = (_TILE_PX, _TILE_PX)
    small = [cv2.resize(tile, size, interpolation=cv2.INTER_AREA) for tile in tiles]
    small += [np.full((*size, 3), 255, np.uint8)] * (-len(small) % _COLUMNS)
    rows = [np.hstack(small[start : start + _COLUMNS]) for start in range(0, len(small), _COLUMNS)]
    return np.asarray(np.vstack(rows), np.uint8)
