"""The command `follower calibrate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer
from typer.core import TyperGroup

from follower.ui.terminal.cli_options import Camera, Config
from follower_control.common.strict_config import SettingsError

if TYPE_CHECKING:
    from follower.apps.calibrate.board import Board

EPILOG = """
**Examples**

`follower calibrate --board board.pdf` – print it at 100 %, measure a square, glue it onto something
flat

`follower calibrate 0` – with a camera: wave the board about until the terminal says it is enough

`follower calibrate clip.mp4 --square-mm 24.8 --out wide.yaml` – from a video, a square as measured

`follower calibrate photos/ --kind chessboard --squares 10x7` – from a folder of images

`follower track clip.mp4 -c wide.yaml --select person` – use it

`follower calibrate latency runs/fly` – how late the camera is, from a recorded flight

Exit code 0: there is a calibration; 1: the views do not determine the lens, and why; 2: an
option or a source cannot be used.
"""
LATENCY_EPILOG = """
**Examples**

`follower calibrate latency runs/fly -c drone.yaml` – from a flight that was recorded with video

`follower calibrate latency --connect udpin:0.0.0.0:14540 --camera 0 -c drone.yaml` – live: turn the
vehicle left and right, in flight or in your hands, disarmed

It needs turns of some degrees a second in both directions, a right field of view, and a view of
things that stand still. Exit code 0: the delay is known; 1: it is not, and why; 2: an option or a
source cannot be used.
"""
_PRINTED = "The board"


def calibrate_command(
    source: Annotated[
        str | None,
        typer.Argument(
            help="A camera (0 or /dev/video0), a stream, a video file or a folder of images; "
            "`camera.source` of the settings by default."
        ),
    ] = None,
    board: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT.PDF|OUT.PNG",
            help="Write the board to print, to scale, and do nothing else.",
            rich_help_panel=_PRINTED,
        ),
    ] = None,
    kind: Annotated[
        str,
        typer.Option(
            metavar="charuco|chessboard",
            help="**charuco** may be seen in part; **chessboard** has to be seen whole.",
            rich_help_panel=_PRINTED,
        ),
    ] = "charuco",
    squares: Annotated[
        str,
        typer.Option(
            metavar="ACROSSxDOWN", help="How many squares it has.", rich_help_panel=_PRINTED
        ),
    ] = "7x10",
    square_mm: Annotated[
        float,
        typer.Option(
            help="Side of a square; the lens does not depend on it.", rich_help_panel=_PRINTED
        ),
    ] = 25.0,
    every_s: Annotated[
        float,
        typer.Option(
            min=0.0, help="Look at one frame in so many seconds; a folder's are all seen."
        ),
    ] = 0.3,
    config: Config = None,
    out: Annotated[
        Path,
        typer.Option(
            metavar="OUT.YAML",
            help="Where the settings with the lens go; a picture goes beside it. With --config "
            "they have that file's settings, too.",
        ),
    ] = Path("camera.yaml"),
) -> None:
    """Find the camera's focal length, axis and distortion with a printed board.

    Hold the board into all parts of the image, near and far, tilted to each side: 20 views are
    good. Views that are blurred or show nothing new are left out by themselves.
    """
    from follower.apps.calibrate.board import write_board
    from follower.apps.calibrate.session import run
    from follower.settings.settings import load_settings

    chosen = _board(kind, squares, square_mm)
    if board is not None:
        if source is not None:
            raise SettingsError("--board writes the board to print; give no source with it")
        try:
            size = write_board(chosen, board)
        except ValueError as error:
            raise SettingsError(str(error)) from None
        typer.echo(f"{board}: {size}. Print it at 100 %, and measure a square afterwards.")
        return
    source = source or load_settings(config).camera.source
    if source is None:
        raise SettingsError("which source? give a camera, a video or a folder; or --board OUT.PDF")
    raise typer.Exit(run(source, chosen, out, config, every_s))


def latency_command(
    flight: Annotated[
        Path | None, typer.Argument(help="A recorded flight's folder; without it, live.")
    ] = None,
    connect: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Live: where the autopilot speaks MAVLink."),
    ] = None,
    camera: Camera = None,
    seconds: Annotated[
        float, typer.Option(min=8, max=600, help="Live: how long; Ctrl-C ends it, too.")
    ] = 30.0,
    config: Config = None,
    out: Annotated[
        Path,
        typer.Option(
            metavar="OUT.YAML",
            help="Where the settings with the delay go; a picture goes beside it. With --config "
            "they have that file's settings, too.",
        ),
    ] = Path("latency.yaml"),
) -> None:
    """Find how late the camera's frames are stamped, from the vehicle's turns.

    The turns that the image shows are compared with the gyro's: where they fit best is the delay,
    `camera.latency_s`.
    """
    from follower.apps.calibrate import latency
    from follower.apps.video_input import VideoInput
    from follower.settings.settings import load_settings

    if flight is not None and connect is not None:
        raise SettingsError("give a recorded flight's folder or --connect, not both")
    if flight is not None:
        turns = latency.recorded_turns(flight, config)
    elif connect is not None:
        settings = load_settings(config)
        video = VideoInput.camera(camera, settings.camera)
        turns = latency.live_turns(settings, video, connect, seconds)
    else:
        raise SettingsError("give a recorded flight's folder, or --connect and a camera")
    raise typer.Exit(latency.run(turns, out, config))


class _LensByDefault(TyperGroup):
    """Takes `calibrate SOURCE` for `calibrate lens SOURCE`."""

    default = "lens"

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        undecided = ctx.resilient_parsing and not args  # a shell completes the first word
        if not undecided and (not args or args[0] not in (*self.commands, "--help")):
            args = [self.default, *args]
        return super().parse_args(ctx, args)

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        default = self.commands[self.default].shell_complete(ctx, incomplete)
        names = {one.value for one in default}
        own = super().shell_complete(ctx, incomplete)
        return [*default, *(one for one in own if one.value not in names)]


calibrate_app = typer.Typer(
    cls=_LensByDefault,
    rich_markup_mode="markdown",
    epilog=EPILOG,
    help="Find the camera's lens (the default) or its delay.",
)
calibrate_app.command("lens", epilog=EPILOG)(calibrate_command)
calibrate_app.command("latency", epilog=LATENCY_EPILOG)(latency_command)


def _board(kind: str, squares: str, square_mm: float) -> Board:
    from follower.apps.calibrate.board import Board, Kind

    if kind not in ("charuco", "chessboard"):
        raise SettingsError(f"--kind {kind}: choose charuco or chessboard")
    across, _, down = squares.lower().partition("x")
    if not (across.isdigit() and down.isdigit()):
        raise SettingsError(f"--squares {squares}: write it like 7x10")
    try:
        return Board(cast(Kind, kind), int(across), int(down), square_mm / 1e3)
    except ValueError as error:
        raise SettingsError(f"--kind {kind} --squares {squares}: {error}") from None
