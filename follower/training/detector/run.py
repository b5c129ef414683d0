"""`follower train detector`: from a configuration to an ONNX file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from rich.console import Console

from follower.print_line import print_line
from follower.training.checkpoint import load_checkpoint, save_checkpoint
from follower.training.detector.anchors import find_anchors, mean_overlap
from follower.training.detector.average_precision import Precision
from follower.training.detector.config import DetectorConfig
from follower.training.detector.eight_bit import (
    Measured,
    is_worth_it,
    measure_files,
    write_eight_bit,
)
from follower.training.detector.export import Exported, export_detector
from follower.training.detector.exported_start import state_of_onnx
from follower.training.detector.folder import FolderPictures
from follower.training.detector.labelled import IGNORED, LabelledImage, Pictures
from follower.training.detector.reading import AnswerReader
from follower.training.detector.sheet import found_sheet, sample_sheet
from follower.training.detector.trainer import DetectorTrainer, as_tensor
from follower.training.progress_bar import progress_bar
from follower.training.progress_log import ProgressLog
from follower_control.strict_yaml import SettingsError
from follower_vision.detection.yolov2 import STRIDE

SAMPLES, DETECTIONS, LOG = "samples.png", "detections.png", "log.csv"
_SHEET_PICTURES = 40
_SHOWN_SCORE = 0.3
_SMOOTHED = 0.95
_RANGE_PICTURES = 120


@dataclass(frozen=True, slots=True)
class TrainingRun:
    """Where and how a training runs.

    Attributes:
        config: what is trained.
        folder: where everything is written.
        device: where it computes.
        resume: go on from the folder's checkpoint.
        start: the folder of another training, or the network (.onnx) that one has written, whose
            weights and anchors this one begins with.
        console: where progress is shown.
    """

    config: DetectorConfig
    folder: Path
    device: torch.device
    console: Console
    resume: bool = False
    start: Path | None = None

    def run(self) -> Exported:
        """Train, measure and export.

        Raises:
            SettingsError: the data or the checkpoint cannot be used.
        """
        torch.set_num_threads(self.config.training.threads)
        cv2.setNumThreads(1)
        state = load_checkpoint(self.folder, self.device) if self.resume else None
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / "config.yaml").write_text(self.config.to_yaml(), encoding="utf-8")
        pictures = pictures_of(self.config)
        trainer = self._trainer(pictures, state)
        side, count = self.config.training.side_px, self.config.training.held_out_pictures
        held_out = pictures.held_out(side, count)
        measured = self._train(trainer, held_out)
        self._show_found(trainer, held_out[:_SHEET_PICTURES])
        exported = export_detector(trainer, self.config, measured, self.folder)
        self._try_eight_bit(exported.path, pictures, held_out)
        return exported

    def _try_eight_bit(self, path: Path, pictures: Pictures, held_out: list[LabelledImage]) -> None:
        """Write NAME-int8.onnx, say what it is worth, and keep it if it is worth it."""
        if not held_out:
            return
        training = self.config.training
        shown = pictures.training(training.side_px, self.config.seed)
        out = path.with_name(f"{path.stem}-int8.onnx")
        write_eight_bit(path, [next(shown) for _ in range(_RANGE_PICTURES)], out)
        trained, eight_bit = measure_files([path, out], held_out)
        kept = is_worth_it(eight_bit, trained)
        print_line(
            self.console,
            f"in 8 bits: {_said(eight_bit)}; as trained: {_said(trained)}: "
            + (str(out) if kept else "not kept"),
        )
        if not kept:
            out.unlink()

    def _trainer(self, pictures: Pictures, state: dict[str, Any] | None) -> DetectorTrainer:
        training, seed = self.config.training, self.config.seed
        start = self._start_state(pictures)
        known = state or start
        anchors = None if known is None else np.array(known["anchors"])
        if state is None or anchors is None:
            anchors = self._look(pictures, anchors)
        trainer = DetectorTrainer(training, pictures, anchors, seed, self.device)
        if state is not None:
            trainer.restore(state)
        elif start is not None:
            trainer.begin_with(start)
        return trainer

    def _start_state(self, pictures: Pictures) -> dict[str, Any] | None:
        if self.start is None or self.start.suffix != ".onnx":
            return None if self.start is None else load_checkpoint(self.start, self.device)
        training, seed = self.config.training, self.config.seed
        stream = pictures.training(training.side_px, seed)
        shown = as_tensor([next(stream) for _ in range(_RANGE_PICTURES)], torch.device("cpu"))
        return state_of_onnx(self.start, training, pictures.class_names, shown)

    def _look(self, pictures: Pictures, anchors: np.ndarray | None) -> np.ndarray:
        """Draw some of the pictures; return the anchors, if none are given those that fit best."""
        training, seed = self.config.training, self.config.seed
        stream = pictures.training(training.side_px, seed)
        count = max(training.anchor_pictures, _SHEET_PICTURES)
        some = [next(stream) for _ in range(count)]
        path = self.folder / SAMPLES
        cv2.imwrite(str(path), sample_sheet(some[:_SHEET_PICTURES], pictures.class_names))
        sizes = _sizes(some) / STRIDE
        if anchors is None:
            anchors = self._anchors(sizes)
        print_line(
            self.console,
            f"{path}: look at it. Anchors fit the boxes by {mean_overlap(sizes, anchors):.2f}.",
        )
        return anchors

    def _anchors(self, sizes: np.ndarray) -> np.ndarray:
        training, seed = self.config.training, self.config.seed
        try:
            return find_anchors(sizes, training.anchors, np.random.default_rng(seed))
        except ValueError as error:
            raise SettingsError(f"there are too few boxes in the pictures: {error}") from error

    def _train(self, trainer: DetectorTrainer, held_out: list[LabelledImage]) -> Precision:
        training = self.config.training
        columns = ("loss", "learning_rate", "mean_average_precision")
        log = ProgressLog(self.folder / LOG, columns, trainer.step_number)
        smooth, measured = 0.0, None
        with progress_bar(self.console) as bar:
            task = bar.add_task("", total=training.steps, completed=trainer.step_number)
            while trainer.step_number < training.steps:
                rate, loss = trainer.learning_rate, trainer.step()
                smooth = loss if not smooth else _SMOOTHED * smooth + (1 - _SMOOTHED) * loss
                step, figures = trainer.step_number, {"loss": loss, "learning_rate": rate}
                if step % training.validate_every == 0 or step == training.steps:
                    measured = trainer.measure(held_out)
                    self._say(step, smooth, measured)
                    figures["mean_average_precision"] = measured.mean or 0.0
                log.add(step, figures)
                if step % training.save_every == 0 or step == training.steps:
                    save_checkpoint(self.folder, trainer.state())
                bar.update(task, completed=step, description=f"loss {smooth:.2f}")
        return measured or trainer.measure(held_out)

    def _say(self, step: int, loss: float, measured: Precision) -> None:
        mean = "-" if measured.mean is None else f"{measured.mean:.3f}"
        print_line(self.console, f"step {step}: loss {loss:.2f}, mAP@0.5 {mean}")

    def _show_found(self, trainer: DetectorTrainer, pictures: list[LabelledImage]) -> None:
        """Draw what the network finds in held-out pictures."""
        if not pictures:
            return
        reader = AnswerReader(trainer.anchors, len(trainer.class_names), trainer.settings.side_px)
        with torch.no_grad():
            answers = trainer.averaged(as_tensor(pictures, self.device)).cpu().numpy()
        found = [reader.read(answer, _SHOWN_SCORE) for answer in answers]
        sheet = found_sheet(pictures, found, trainer.class_names)
        cv2.imwrite(str(self.folder / DETECTIONS), sheet)


def pictures_of(config: DetectorConfig) -> Pictures:
    """Return where a configuration's pictures come from.

    Raises:
        SettingsError: the user's folder cannot be used.
    """
    if config.data is None:
        return config.rendered
    return FolderPictures(config.data, config.folder, config.seed)


def _said(one: Measured) -> str:
    mean = "-" if one.precision is None else f"{one.precision:.3f}"
    return f"mAP@0.5 {mean}, {one.work_ms:.2f} ms"


def _sizes(pictures: list[LabelledImage]) -> np.ndarray:
    """Return widths and heights, (N, 2), of all that is to be found."""
    sides = [one.boxes[one.classes != IGNORED] for one in pictures]
    corners = np.concatenate([*sides, np.empty((0, 4), np.float32)]).astype(np.float64)
    return np.asarray(corners[:, 2:] - corners[:, :2])
