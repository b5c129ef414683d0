"""`follower train re3`: from a configuration to an ONNX file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from rich.console import Console

from follower.configs import configs_folder
from follower.print_line import print_line
from follower.training.checkpoint import load_checkpoint, save_checkpoint
from follower.training.progress_bar import progress_bar
from follower.training.progress_log import ProgressLog
from follower.training.re3.calibration import calibrated
from follower.training.re3.card import model_card
from follower.training.re3.config import Re3Config
from follower.training.re3.export import Exported, export_re3
from follower.training.re3.sheet import sample_sheet
from follower.training.re3.trainer import LOSSES, Re3Trainer
from follower.training.scenes.maker import SceneMaker
from follower.training.scenes.pictures import Pictures
from follower.training.scenes.rendered import rendered
from follower.training.scenes.stock import load_any, prepare

SAMPLES, LOG, STOCK, CONFIG = "samples.png", "log.csv", "stock", "config.yaml"
_SMOOTHED = 0.98
_WORLDS = 5
"""Tells the simulated worlds' numbers from those of other things of the same seed."""


@dataclass(frozen=True, slots=True)
class Re3Run:
    """Where and how a training runs.

    Attributes:
        config: what is trained.
        folder: where everything is written.
        device: where it computes.
        console: where progress is shown.
        resume: go on from the folder's checkpoint.
    """

    config: Re3Config
    folder: Path
    device: torch.device
    console: Console
    resume: bool = False

    def run(self) -> Exported:
        """Train, measure and export.

        Raises:
            SettingsError: the pictures or the checkpoint cannot be used.
        """
        torch.set_num_threads(self.config.training.threads)
        cv2.setNumThreads(1)
        state = load_checkpoint(self.folder, self.device) if self.resume else None
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / CONFIG).write_text(self.config.to_yaml(), encoding="utf-8")
        self._prepare()
        pictures = learnt_from(self.config, self.folder)
        trainer = Re3Trainer(self.config.training, pictures, self.device)
        if state is None:
            self._look(pictures)
        else:
            trainer.restore(state)
        return finished(trainer, self.config, self.folder, self._train(trainer))

    def _prepare(self) -> None:
        """Make the pictures small, once, if there are any."""
        folder, stock = self.config.pictures, self.folder / STOCK
        if folder is None or stock.is_dir():
            return
        listing = configs_folder() / "train" / "pictures.yaml"
        with progress_bar(self.console) as bar:
            task = bar.add_task("pictures made small", total=None)
            prepare(
                folder,
                listing,
                stock,
                self.config.training.seed,
                lambda done, total: bar.update(task, completed=done, total=total),
            )

    def _look(self, pictures: Pictures) -> None:
        training, path = self.config.training, self.folder / SAMPLES
        cv2.imwrite(str(path), sample_sheet(SceneMaker(pictures, training.scenes, training.seed)))
        print_line(self.console, f"{path}: look at it.")

    def _train(self, trainer: Re3Trainer) -> float:
        """Return the last validation's mean overlap."""
        training = self.config.training
        columns = ("stage", "rate", *LOSSES, "overlap")
        log = ProgressLog(self.folder / LOG, columns, trainer.step)
        smooth, overlap = 0.0, float("nan")
        with progress_bar(self.console) as bar:
            task = bar.add_task("", total=training.steps, completed=trainer.step)
            while not trainer.done:
                report = trainer.train_step()
                loss = report.losses["total"]
                smooth = loss if not smooth else _SMOOTHED * smooth + (1 - _SMOOTHED) * loss
                figures = {"stage": report.stage, "rate": report.rate, **report.losses}
                if report.step % training.validate_every == 0 or trainer.done:
                    overlap = figures["overlap"] = trainer.validate()
                    self._say(report.step, smooth, overlap)
                log.add(report.step, figures)
                if report.step % training.save_every == 0 or trainer.done:
                    save_checkpoint(self.folder, trainer.state())
                bar.update(task, completed=report.step, description=f"loss {smooth:.3f}")
        return overlap if np.isfinite(overlap) else trainer.validate()

    def _say(self, step: int, loss: float, overlap: float) -> None:
        print_line(
            self.console, f"step {step}: loss {loss:.3f}, overlap on held-out scenes {overlap:.3f}"
        )


def learnt_from(config: Re3Config, folder: Path) -> Pictures:
    """Return what the scenes of a training are made of: prepared pictures and rendered ones."""
    seed, worlds = config.training.seed, config.training.worlds
    pictures = load_any(folder / STOCK, seed)
    return pictures.joined(rendered(np.random.default_rng((seed, _WORLDS)), worlds))


def finished(trainer: Re3Trainer, config: Re3Config, folder: Path, overlap: float) -> Exported:
    """Write the network of a training and its card, NAME.onnx and NAME.md."""
    calibration = calibrated(trainer.track_held_out(1))
    exported = export_re3(trainer.averaged, folder / f"{config.name}.onnx", calibration)
    card = model_card(config, exported, trainer.averaged, trainer.step, overlap)
    exported.path.with_suffix(".md").write_text(card, encoding="utf-8")
    return exported
