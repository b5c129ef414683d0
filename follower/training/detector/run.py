"""`follower train detector`: from a configuration to an ONNX file."""

import json
import time
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import torch
import typer

from follower.training import quantise
from follower.training.detector.dataset import FolderPictures
from follower.training.detector.labelled_image import (
    IGNORED,
    LabelledImage,
    TrainingImages,
)
from follower.training.detector.loss import find_anchors
from follower.training.detector.network import state_of_onnx
from follower.training.detector.settings import DetectorConfig
from follower.training.detector.trainer import (
    DetectorTrainer,
    Precision,
    as_tensor,
    mean_average_precision,
)
from follower.training.onnx_export import ExportedNetwork, export_network, write_card
from follower.training.trainer import load_checkpoint, open_training, show_samples, train
from follower_control.common.strict_config import SettingsError
from follower_vision.detection.families import YOLOV2_STRIDE
from follower_vision.images.frame import Image
from follower_vision.onnx_network import Feeds, Network

_INPUT = "pictures"
_TIMED = 15
_CPU = torch.device("cpu")


def export_detector(trainer: DetectorTrainer, path: Path) -> ExportedNetwork:
    """Write the averaged network, with class names and anchors in its metadata.

    Raises:
        ModelError: the file does not answer as the network does.
    """
    pairs = [[round(float(length), 5) for length in pair] for pair in trainer.anchors]
    metadata = {
        "names": str(list(trainer.class_names)),
        "anchors": json.dumps(pairs),
        "family": "yolov2",
    }

    def noise(rng: np.random.Generator) -> tuple[torch.Tensor]:
        side = trainer.settings.side_px
        return (torch.from_numpy(rng.random((1, 3, side, side), np.float32)),)

    network = trainer.averaged.cpu().eval()
    return export_network(network, path, noise, ((_INPUT,), ("region",)), metadata)


def write_detector_card(
    exported: ExportedNetwork, trainer: DetectorTrainer, config: DetectorConfig, measured: Precision
) -> None:
    """Write NAME.md."""
    settings, side = trainer.settings, trainer.settings.side_px
    begun_with = trainer.begun_with
    rendered = "scenes of the simulator's own renderer (no photographs)"
    rows = [
        ("input", f"1 x 3 x {side} x {side}, RGB, 0 to 1"),
        ("data", rendered if config.data is None else f"the user's pictures in `{config.data}`"),
        (
            "recipe",
            f"{trainer.step_number} steps of {settings.batch} pictures, "
            f"AdamW {settings.learning_rate:g}, seed {config.seed}",
        ),
        *([("begun with the weights of", f"`{begun_with}`")] if begun_with else []),
        ("mAP@0.5, held out", f"{_rounded(measured.mean)} ({len(trainer.held_out)} pictures)"),
    ]
    classes = ["| class | objects | average precision |", "|---|---|---|"]
    for name, value, count in zip(
        trainer.class_names, measured.of_class, measured.objects, strict=True
    ):
        classes.append(f"| {name} | {count} | {_rounded(value)} |")
    about = f"A detector of the YOLO v2 family: {', '.join(trainer.class_names)}."
    write_card(exported, config, trainer.averaged, about, rows, [*classes, ""])


def _rounded(precision: float | None) -> str:
    return "not measured" if precision is None else f"{precision:.3f}"


def measure_files(
    paths: Sequence[Path], trainer: DetectorTrainer, pictures: Sequence[LabelledImage]
) -> list[tuple[float, float]]:
    """Return mAP@0.5 and median processor time in ms of detectors' files, timed in turn.

    Args:
        paths: of the files, each in 32 or 8 bits.
        trainer: has trained them.
        pictures: to measure with, at least one with an object.
    """
    networks = [Network(path) for path in paths]
    times: list[list[float]] = [[] for _ in networks]
    inputs = [as_tensor([picture], _CPU).numpy() for picture in pictures]
    for number in range(_TIMED):
        for network, spent in zip(networks, times, strict=True):
            begun = time.process_time()
            network.run(inputs[number % len(inputs)])
            spent.append(1e3 * (time.process_time() - begun))
    measured = []
    for network, spent in zip(networks, times, strict=True):
        found = [trainer.reader.read(network.run(picture)[0][0]) for picture in inputs]
        precision = mean_average_precision(found, pictures, len(trainer.class_names)).mean
        measured.append((precision or 0.0, float(np.median(spent))))
    return measured


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
    state = open_training(config.training, folder, device, resume)
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
        if begin.get("kind") != DetectorTrainer.kind:
            raise SettingsError(f"--start {start}: this is no training of a detector")
    known = state or begin
    anchors = None if known is None else np.array(known["anchors"])
    if state is None or anchors is None:
        anchors = _show_samples(config, pictures, folder, anchors)
    trainer = DetectorTrainer(config.training, pictures, anchors, config.seed, device)
    if state is not None:
        trainer.restore(state)
    elif begin is not None:
        trainer.begin_with(begin, str(start))
    train(trainer, config, folder)
    exported = export_detector(trainer, folder / f"{config.name}.onnx")
    measured = trainer.measure(trainer.held_out)
    write_detector_card(exported, trainer, config, measured)
    if trainer.held_out:
        cv2.imwrite(str(folder / DETECTIONS), _found_sheet(trainer))
    if measured.mean is not None:
        try_eight_bit(exported.path, shown, trainer)
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
    show_samples(folder, _sheet(tiles))
    wanted = [one.boxes[one.classes != IGNORED] for one in some]
    corners = np.concatenate([*wanted, np.empty((0, 4), np.float32)]).astype(np.float64)
    sizes = (corners[:, 2:] - corners[:, :2]) / YOLOV2_STRIDE
    if anchors is None:
        anchors = find_anchors(sizes, config.training.anchors, config.seed)
    return anchors


def try_eight_bit(path: Path, shown: Sequence[LabelledImage], trainer: DetectorTrainer) -> None:
    """Write NAME-int8.onnx, report what it is worth, and keep it if it is faster at no loss."""
    out = path.with_name(f"{path.stem}-int8.onnx")
    feeds: list[Feeds] = [{_INPUT: as_tensor([picture], _CPU).numpy()} for picture in shown]
    quantise.reduce_file(path, quantise.Precision.INT8, feeds, out)
    whole, small = measure_files([path, out], trainer, trainer.held_out)
    kept = whole[0] - small[0] <= quantise.MOST_LOSS and small[1] < whole[1]
    words = [f"mAP@0.5 {precision:.3f}, {work_ms:.2f} ms" for precision, work_ms in (small, whole)]
    result = str(out) if kept else "not kept"
    typer.echo(f"in 8 bits: {words[0]}; as trained: {words[1]}: {result}")
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
