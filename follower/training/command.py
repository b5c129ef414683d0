"""`follower train`: our own networks, from scratch or on the user's data."""

from __future__ import annotations

import typer

from follower.training.detector.command import EPILOG as DETECTOR_EPILOG
from follower.training.detector.command import train_detector_command
from follower.training.re3.command import EPILOG as RE3_EPILOG
from follower.training.re3.command import train_re3_command
from follower.training.scenes.command import EPILOG as SEQUENCES_EPILOG
from follower.training.scenes.command import sequences_command

train_app = typer.Typer(
    help="Train the networks that come along, or one for your own target; needs the extra `train`.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)
train_app.command("detector", epilog=DETECTOR_EPILOG)(train_detector_command)
train_app.command("re3", epilog=RE3_EPILOG)(train_re3_command)
train_app.command("sequences", epilog=SEQUENCES_EPILOG)(sequences_command)
