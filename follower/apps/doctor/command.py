"""The command `follower doctor`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from follower.ui.terminal.cli_options import Config, Out, Overrides

EPILOG = """
**Examples**

`follower doctor` – what is wrong with this computer or installation, and what to type

`follower doctor -c drone.yaml` – also with your settings: lens, networks, signing key, disk

`follower doctor --json` – the same for programs

Nothing is sent or changed. Exit code 0: nothing is wrong, there may be warnings; 1: something is;
2: an option cannot be used.
"""


def doctor_command(
    config: Config = None,
    overrides: Overrides = None,
    as_json: Annotated[bool, typer.Option("--json", help="Everything, for programs.")] = False,
    out: Out = Path("runs"),
) -> None:
    """Check packages, networks, devices, rights and the computer; no vehicle is needed.

    Each check says pass, warn, fail or unknown, why, and what to type.
    """
    from rich.console import Console

    from follower.apps.command_settings import command_settings, lens_is_given
    from follower.apps.doctor.checks import examine
    from follower.apps.doctor.reading import read_installation
    from follower.apps.preflight.checklist import print_checklist, to_json

    settings = command_settings(config, overrides)
    found = read_installation(settings, out, lens_is_given(config, overrides))
    results = examine(found, own_settings=config is not None)
    if as_json:
        typer.echo(to_json(results))
    else:
        print_checklist(Console(), results, "Nothing is wrong", "Something is wrong")
    raise typer.Exit(int(any(result.refuses for result in results)))
