"""Trains networks of GOTURN's and SiamFC's kind out of our Re3's parts, to compare with it.

    python benchmarks/re3_peers.py goturn --pictures pictures/
    python benchmarks/re3_peers.py siamfc --pictures pictures/

Writes runs/train/KIND/KIND.onnx, which runs wherever a tracker is named.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import command_line
import torch
from torch import Tensor
from torch.nn import functional

from follower.training.re3.network import Re3Answer, Re3Module, Re3ModuleState, centred
from follower.training.re3.run import RE3
from follower.training.re3.settings import Re3Config, Re3TrainingSettings, TrainingStage
from follower.training.re3.trainer import Re3Trainer
from follower.training.settings import RUNS
from follower_vision.trackers.re3 import PLACES, SEARCH_PX

_STRETCHES_PX = (0, -3, 3)
"""By how much each side of the crop is moved out to look for a target that has grown."""
_SCALE_PENALTY = 0.99
_SCALE_RATE = 0.59
_GAIN = 4.0


class TwoFrameNetwork(Re3Module):
    """Knows the target from the frame before alone, and carries nothing on.

    What Held, Thrun and Savarese's GOTURN (ECCV 2016) does, but with cells compared in the place of
    fully connected layers.
    """

    def forward(
        self,
        last: Tensor,
        present: Tensor,
        size: Tensor,
        memory: Tensor,
        memory_size: Tensor,
        state: Re3ModuleState,
    ) -> Re3Answer:
        """See `Re3Module`; the first frame's features and the state are not looked at."""
        blank = Re3ModuleState(torch.zeros_like(state.hidden), torch.zeros_like(state.cell))
        answer = super().forward(last, present, size, last, size, blank)
        return answer._replace(box=_tied(answer.box, memory, memory_size), state=state)


class SiameseNetwork(Re3Module):
    """Slides the first frame's features over the new crop: the likeness itself is the score.

    After Bertinetto, Valmadre, Henriques, Vedaldi and Torr's SiamFC (ECCV 2016 workshops), with a
    normalised correlation. The box keeps its shape; its size follows the best of three scales.
    """

    def forward(
        self,
        last: Tensor,  # noqa: ARG002  part of the interface
        present: Tensor,
        size: Tensor,
        memory: Tensor,
        memory_size: Tensor,
        state: Re3ModuleState,
    ) -> Re3Answer:
        """See `Re3Module`; the frame before and the state are not looked at."""
        same = self._at(0, present, memory, memory_size, state)
        if self.training:
            return same[0]
        looks = [
            same,
            *(self._at(px, present, memory, memory_size, state) for px in _STRETCHES_PX[1:]),
        ]
        peaks = torch.stack([looks[0][1], *(peak * _SCALE_PENALTY for _, peak in looks[1:])])
        boxes = torch.stack([answer.box for answer, _ in looks])
        best = functional.one_hot(peaks.argmax(dim=0), len(looks)).to(boxes.dtype).T[:, :, None]
        return same[0]._replace(box=_tied((boxes * best).sum(dim=0), size))

    def _at(
        self,
        stretch_px: int,
        present: Tensor,
        memory: Tensor,
        memory_size: Tensor,
        state: Re3ModuleState,
    ) -> tuple[Re3Answer, Tensor]:
        """Return the answer at one scale, and how like the target the best place is, (N,)."""
        factor = 1.0 + 2.0 * stretch_px / SEARCH_PX
        features = self.trunk(centred(_stretched(present, stretch_px)))
        unit = functional.normalize(features, dim=1)
        likeness = self._likeness(memory, memory_size, unit).sum(dim=1).flatten(1)
        scores = likeness * self.sharpness.exp() * _GAIN + self.prior.bias
        shapes = scores.new_zeros(len(scores), 4, PLACES**2)
        box = self._decode(self._near_best(scores), shapes)
        grown = torch.full_like(box[:, 2:], factor).log() * _SCALE_RATE
        peak = likeness.amax(dim=1)
        seen = self.recalled.bias + peak * self.sharpness.exp()
        box = torch.cat([box[:, :2] * factor, grown], dim=1)
        return Re3Answer(box, seen, scores, shapes, state), peak


def _tied(box: Tensor, *unused: Tensor) -> Tensor:
    """Return the box, seemingly made of inputs too that an exporter would leave out otherwise."""
    return box + 0.0 * torch.stack([tensor.mean() for tensor in unused]).sum()


def _stretched(present: Tensor, stretch_px: int) -> Tensor:
    """Return crops of an area larger (or smaller) by so many pixels on each side."""
    if not stretch_px:
        return present
    margins = (stretch_px,) * 4
    wider = functional.pad(present, margins, "replicate" if stretch_px > 0 else "constant")
    return functional.interpolate(
        wider, size=(SEARCH_PX, SEARCH_PX), mode="bilinear", align_corners=False
    )


PEERS: dict[str, tuple[type[Re3Module], int]] = {
    "goturn": (TwoFrameNetwork, 1250),
    "siamfc": (SiameseNetwork, 2000),
}
"""Networks, and the steps of their training."""


def main() -> None:
    """Train one of them."""
    parser = command_line.parser(__doc__)
    parser.add_argument("kind", choices=PEERS)
    parser.add_argument("--pictures", type=Path, help="as for `follower train re3`")
    arguments = parser.parse_args()
    network_type, steps = PEERS[arguments.kind]
    stages = (TrainingStage(steps=steps, batch=24, rate=0.0015),)
    config = Re3Config(
        name=arguments.kind,
        licence="Apache-2.0",
        pictures=arguments.pictures,
        training=Re3TrainingSettings(stages=stages, validate_every=500),
    )
    folder = RUNS / config.name
    training = replace(RE3, make_trainer=partial(Re3Trainer, network_type=network_type))
    training.run(config, folder, torch.device("cpu"))


if __name__ == "__main__":
    command_line.run(main)
