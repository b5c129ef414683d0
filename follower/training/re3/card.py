"""The description that goes with Re3's weights."""

from __future__ import annotations

from follower.training.re3.config import Re3Config
from follower.training.re3.export import Exported
from follower.training.re3.network import Re3Network

_WHAT = {
    "re3": (
        "A motion tracker: a small Re3 (Gordon, Farhadi, Fox, RA-L 2018), with departures that\n"
        "docs/training.md lists."
    ),
    "goturn": "A motion tracker to compare Re3 with: it knows the frame before alone.",
    "siamfc": "A motion tracker to compare Re3 with: it knows the first frame alone.",
}


def model_card(
    config: Re3Config, exported: Exported, network: Re3Network, steps: int, overlap: float
) -> str:
    """Return the card in Markdown.

    Args:
        config: of the training.
        exported: the file.
        network: whose parameters are counted.
        steps: that it has learnt.
        overlap: mean overlap on held-out generated scenes.
    """
    training = config.training
    count = sum(value.numel() for value in network.parameters())
    return "\n".join(
        [
            f"# {config.name}",
            "",
            _WHAT[training.network.kind],
            "",
            "| | |",
            "|---|---|",
            f"| file | `{exported.path.name}`, {exported.path.stat().st_size} bytes |",
            f"| sha256 | `{exported.sha256}` |",
            f"| licence | {config.licence} |",
            f"| parameters | {count} |",
            f"| data | {config.data} |",
            f"| recipe | {steps} steps, AdamW, seed {training.seed} |",
            *(
                f"| stage | {stage.steps} steps of {stage.batch} targets, {stage.unroll} frames, "
                f"rate {stage.rate:g}, own boxes {stage.own_boxes:g} |"
                for stage in training.stages
            ),
            f"| mean overlap, held-out scenes | {overlap:.3f} ({training.validation_scenes} of "
            f"{training.validation_frames} frames) |",
            f"| torch and ONNX differ by | {exported.difference:.1e} |",
            "",
        ]
    )
