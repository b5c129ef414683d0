"""The training loop: steps, measurements on held-out data, the log and the checkpoint."""

from __future__ import annotations

import copy
import csv
import io
import math
import pickle
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

import cv2
import torch
import typer
import yaml
from rich.progress import MofNCompleteColumn, Progress
from torch import Tensor, nn
from torch.nn.utils import clip_grad_norm_

from follower.training.settings import TrainingConfig, TrainingPlan
from follower.ui.terminal.console import print_line
from follower_control.common.strict_config import SettingsError
from follower_vision.disk import write_whole_bytes
from follower_vision.images.frame import Image

CHECKPOINT, CONFIG, LOG, SAMPLES = "checkpoint.pt", "config.yaml", "log.csv", "samples.png"
_SMOOTHED = 0.97
_BROKEN = (RuntimeError, EOFError, ValueError, TypeError, LookupError, pickle.UnpicklingError)
"""What torch raises for a damaged file: it takes its strings and numbers for sound."""

NetworkT = TypeVar("NetworkT", bound=nn.Module)


class Trainer(ABC, Generic[NetworkT]):
    """A network that learns, a moving average of its weights, and the number of steps done.

    The average is what is measured and exported.

    Args:
        network: on its device.
        plan: of the training.
        steps: of the optimiser in the whole training.
        size: what a checkpoint's network must have in common with this one.

    Attributes:
        kind: of network, written into checkpoints.
        figures: names of what `train_step` returns, columns of the log.
        quality: name of what `validate` returns, the log's last column.
        largest_gradient: norm to which gradients are clipped.
    """

    kind: ClassVar[str]
    figures: ClassVar[tuple[str, ...]]
    quality: ClassVar[str]
    largest_gradient: ClassVar[float]

    def __init__(
        self,
        network: NetworkT,
        plan: TrainingPlan,
        steps: int,
        size: Mapping[str, Any] | None = None,
    ) -> None:
        self.plan = plan
        self._size = dict(size or {})
        self.steps = steps
        self.network = network
        self.averaged = copy.deepcopy(network).eval()
        self.step_number = 0
        self._optimiser = torch.optim.AdamW(network.parameters(), weight_decay=plan.weight_decay)

    @abstractmethod
    def train_step(self) -> dict[str, float]:
        """Learn from one batch; return the figures by name, among them the loss."""

    @abstractmethod
    def validate(self) -> float:
        """Return the averaged network's quality on held-out data, 0 to 1."""

    @property
    def done(self) -> bool:
        """Whether all steps are done."""
        return self.step_number >= self.steps

    def state(self) -> dict[str, Any]:
        """Return all that a resumption needs."""
        return {
            "kind": self.kind,
            "size": self._size,
            "step": self.step_number,
            "network": self.network.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimiser": self._optimiser.state_dict(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state.

        Raises:
            SettingsError: it belongs to another network.
        """
        self.check(state)
        self.network.load_state_dict(state["network"])
        self.averaged.load_state_dict(state["averaged"])
        self._optimiser.load_state_dict(state["optimiser"])
        self.step_number = int(state["step"])

    def check(self, state: dict[str, Any]) -> None:
        """Make sure that a state fits this network.

        Raises:
            SettingsError: it belongs to another network.
        """
        if (state.get("kind"), state.get("size")) != (self.kind, self._size):
            raise SettingsError("the checkpoint is of another network, or of another size")

    def _descend(self, loss: Tensor, learning_rate: float) -> None:
        """Do one step of the optimiser, and let the averaged weights follow, quickly at first."""
        for group in self._optimiser.param_groups:
            group["lr"] = learning_rate
        self._optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        clip_grad_norm_(self.network.parameters(), self.largest_gradient)
        self._optimiser.step()
        self.step_number += 1
        kept = min(self.plan.average, self.step_number / (self.step_number + 9))
        fresh = self.network.state_dict()
        with torch.no_grad():
            for name, value in self.averaged.state_dict().items():
                if value.is_floating_point():
                    value.lerp_(fresh[name], 1 - kept)
                else:
                    value.copy_(fresh[name])


def open_training(
    plan: TrainingPlan, folder: Path, device: torch.device, resume: bool
) -> dict[str, Any] | None:
    """Return the state to go on from, None to begin; the folder is not made yet.

    Raises:
        SettingsError: there is no usable checkpoint to resume, or one that would be written over.
    """
    torch.set_num_threads(plan.threads)
    cv2.setNumThreads(1)
    if resume:
        return load_checkpoint(folder, device)
    if (folder / CHECKPOINT).exists():
        raise SettingsError(
            f"{folder}: a training is there already: go on with it by --resume {folder}, or give "
            "this one another name by --set name=…"
        )
    return None


def show_samples(folder: Path, sheet: Image) -> None:
    """Make a training's folder, with a picture in it of what it begins to learn from.

    Raises:
        OSError: the folder cannot be made.
    """
    folder.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(folder / SAMPLES), sheet)
    typer.echo(f"{folder / SAMPLES}: look at it.")


def train(trainer: Trainer[Any], config: TrainingConfig, folder: Path) -> None:
    """Do all steps that are left; the training can be interrupted at any time.

    Raises:
        SettingsError: the loss is no number; the checkpoint is that of before.
        KeyboardInterrupt: Ctrl-C; how the training goes on was said.
    """
    resolved = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)
    (folder / CONFIG).write_text(resolved, encoding="utf-8")
    log = ProgressLog(
        folder / LOG, ("step", *trainer.figures, trainer.quality), trainer.step_number
    )
    columns = (*Progress.get_default_columns(), MofNCompleteColumn())
    with Progress(*columns, transient=True) as bar:
        try:
            _do_steps(trainer, folder, log, bar)
        except KeyboardInterrupt:
            if (folder / CHECKPOINT).is_file():
                again = f"go on from the last checkpoint with --resume {folder}"
                print_line(bar.console, f"interrupted; {again}")
            raise


def _do_steps(trainer: Trainer[Any], folder: Path, log: ProgressLog, bar: Progress) -> None:
    smooth = 0.0
    task = bar.add_task("", total=trainer.steps, completed=trainer.step_number)
    while not trainer.done:
        figures = trainer.train_step()
        step, loss = trainer.step_number, figures["loss"]
        if not math.isfinite(loss):
            raise SettingsError(
                f"{folder}, step {step}: the loss is {loss}: the training has diverged; try a "
                "smaller learning rate"
            )
        smooth = _SMOOTHED * smooth + (1 - _SMOOTHED) * loss if smooth else loss
        if step % trainer.plan.validate_every == 0 or trainer.done:
            quality = figures[trainer.quality] = trainer.validate()
            words = f"step {step}: loss {smooth:.3f}, {trainer.quality} {quality:.3f}"
            print_line(bar.console, words)
        log.add(step, figures)
        if step % trainer.plan.save_every == 0 or trainer.done:
            save_checkpoint(folder, trainer.state())
        bar.update(task, completed=step, description=f"loss {smooth:.3f}")


def save_checkpoint(folder: Path, state: dict[str, Any]) -> None:
    """Write a checkpoint as a whole or not at all.

    Args:
        folder: of the training.
        state: tensors, plain numbers and texts, in dicts and lists.

    Raises:
        OSError: it cannot be written.
    """
    content = io.BytesIO()
    torch.save(state, content)
    write_whole_bytes(folder / CHECKPOINT, content.getvalue())


def load_checkpoint(folder: Path, device: torch.device) -> dict[str, Any]:
    """Read the checkpoint of a training.

    Raises:
        SettingsError: there is none, or it is broken.
    """
    path = folder / CHECKPOINT
    if not path.is_file():
        raise SettingsError(f"{path}: there is no such file; a training writes it now and then")
    try:
        state: dict[str, Any] = dict(torch.load(path, map_location=device, weights_only=True))
    except _BROKEN as error:
        raise SettingsError(
            f"{path}: this is no checkpoint of ours, or it is broken ({type(error).__name__})"
        ) from error
    return state


class ProgressLog:
    """Appends rows; after a resumption, rows of later steps are dropped.

    Args:
        path: the file.
        columns: names; the first is `step`.
        resumed_at: the step that the training goes on from, 0 begins anew.
    """

    def __init__(self, path: Path, columns: tuple[str, ...], resumed_at: int = 0) -> None:
        self._path = path
        self._columns = columns
        rows: list[dict[str, str]] = []
        if resumed_at and path.is_file():
            with path.open(newline="", encoding="utf-8") as file:
                rows = [row for row in csv.DictReader(file) if int(row["step"]) <= resumed_at]
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, columns, extrasaction="ignore")
            writer.writeheader()
            writer.writerows(rows)

    def add(self, step: int, figures: Mapping[str, float]) -> None:
        """Write the figures known at a step; those missing are left empty."""
        row = {name: f"{value:.6g}" for name, value in figures.items()}
        with self._path.open("a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, self._columns).writerow({"step": step, **row})
