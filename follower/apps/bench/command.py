"""The command `follower bench`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from follower.ui.terminal.cli_options import Out

EPILOG = """
**Examples**

`follower bench` – on the board itself, with nothing else running; at most three minutes

`follower bench --quick --rate 25` – half a minute, for a camera of 25 frames a second

`follower bench --name "Raspberry Pi 5, 8 GB" --note "fan, Raspberry Pi OS"` – to show to others

`follower bench --compare a.json b.json` – several boards side by side

Frames of one rendered flight come as JPEG and never run out, so a rate is what capture and vision
reach together while control steps at 50 Hz and the recorder writes. OpenCV and each network have
one thread, as in a flight. `follower models pull` fetches more networks to measure.
"""


def bench_command(
    files: Annotated[
        list[Path] | None, typer.Argument(help="With --compare: files that a bench has written.")
    ] = None,
    compare: Annotated[
        bool, typer.Option("--compare", help="Measure nothing; show files side by side.")
    ] = False,
    rate: Annotated[
        float, typer.Option(min=1, max=1000, help="Frames a second of the camera.")
    ] = 30.0,
    quick: Annotated[
        bool, typer.Option("--quick", help="Half a minute: the best tracker, alone and in Fusion.")
    ] = False,
    name: Annotated[
        str | None, typer.Option(help="The board's name; its processor's by default.")
    ] = None,
    note: Annotated[str, typer.Option(help="Who measured, and what else ran meanwhile.")] = "",
    out: Out = Path("runs"),
) -> None:
    """Measure what this computer holds, and say which tracker, detector and camera size to take.

    It writes bench.json, bench.png and advised.yaml, and remembers the figures: `follower fly` says
    so when a flight asks for more. Ctrl-C ends it in order and keeps what was measured.
    """
    from follower.apps.bench import run
    from follower_control.common.strict_config import SettingsError

    if compare:
        raise typer.Exit(run.compare(files or (), out))
    if files:
        raise SettingsError(f"{files[0]}: files are for --compare")
    budget_s = run.QUICK_S if quick else run.USUAL_S
    options = run.BenchOptions(rate, quick, budget_s, name=name, note=note)
    raise typer.Exit(run.bench(options, out))
