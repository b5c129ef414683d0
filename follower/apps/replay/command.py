"""The command `follower replay`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from follower.ui.terminal.cli_options import Cockpit, Out, Overrides

EPILOG = """
**Examples**

`follower replay runs/demo` – do the recorded frames and telemetry give the same setpoints again?

`follower replay runs/demo --set servo.range.kp=0.8` – what would it have asked for?

`follower replay runs/demo --cockpit` – watch it on a web page, and the other flights beside it

`follower replay runs/demo --tracker nanotrack-v3 --save` – another tracker; keep what comes of it
"""


def replay_command(
    flight: Annotated[Path, typer.Argument(help="A flight's folder, with flight.mcap in it.")],
    overrides: Overrides = None,
    tracker: Annotated[
        str | None, typer.Option(help="Another motion tracker; see `follower trackers`.")
    ] = None,
    detector: Annotated[str | None, typer.Option(help="Another detector.")] = None,
    save: Annotated[
        bool,
        typer.Option(
            "--save",
            help="Keep the replay as a flight of its own: for lossy video, the reference that "
            "later replays have to match bit for bit.",
        ),
    ] = False,
    out: Out = Path("runs"),
    cockpit: Cockpit = False,
) -> None:
    """Replay a recorded flight through the code that flies, and compare.

    The recorded frames and telemetry go through vision and control again; every track, estimate
    and setpoint is compared with the recorded one. The exit code is 0 if they are the same to the
    last bit, as far as the recording allows to tell, and 1 if they differ.

    With **--set**, **--tracker** or **--detector** it shows what the flight would have asked for
    with other settings, open loop; the exit code is then 0.
    """
    from follower.apps.replay.run import replay_flight

    chosen = {"tracker": tracker, "detector": detector}
    named = [f"{key}={value}" for key, value in chosen.items() if value is not None]
    changes = (*(overrides or ()), *named)
    if cockpit:
        from follower.apps.replay.playback_page import replay_on_page

        replay_on_page(flight, changes)
        return
    raise typer.Exit(replay_flight(flight, changes, save, out))
