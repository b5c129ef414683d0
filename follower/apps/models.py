"""`follower models`: the networks that the tracker and the detector run on."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import DownloadColumn, Progress, TransferSpeedColumn
from rich.table import Table

from follower_vision.models import FileState, ModelStore, VisionModel, default_folder

models_app = typer.Typer(
    help="List, fetch and verify the networks.", no_args_is_help=True, rich_markup_mode=None
)

Folder = Annotated[
    Path | None,
    typer.Option(
        "--folder", help="Where they are kept; $FOLLOWER_MODELS or the user's cache otherwise."
    ),
]
Names = Annotated[list[str] | None, typer.Argument(help="Names as `list` shows them.")]


@models_app.command("list")
def list_models(folder: Folder = None) -> None:
    """Show the networks known, and which of them are there."""
    store = _store(folder)
    table = Table(caption=f"in {store.folder}", show_edge=False, pad_edge=False)
    for heading in ("name", "for", "MB", "licence", "there", "what"):
        table.add_column(heading, overflow="fold")
    for model in store.models:
        size = f"{model.size_bytes / 1e6:.1f}"
        there = "comes along" if model.embedded else "yes" if store.is_present(model) else "no"
        table.add_row(model.name, model.purpose, size, model.licence, there, model.summary)
    Console().print(table)


@models_app.command()
def pull(
    names: Names = None,
    folder: Folder = None,
    everything: Annotated[bool, typer.Option("--all", help="All that can be fetched.")] = False,
) -> None:
    """Fetch networks; without names the usual tracker and detector."""
    store = _store(folder)
    models = [store.model(name) for name in names or []] or [
        one for one in store.models if one.usual or (everything and one.can_be_fetched)
    ]
    for model in models:
        for path in _pull_one(store, model):
            typer.echo(str(path))


@models_app.command()
def path(
    name: Annotated[str | None, typer.Argument(help="A name as `list` shows it.")] = None,
    folder: Folder = None,
) -> None:
    """Print where networks are kept, or the paths of one network's files."""
    store = _store(folder)
    for one in [store.folder] if name is None else store.paths(store.model(name)):
        typer.echo(str(one))


@models_app.command()
def verify(names: Names = None, folder: Folder = None) -> None:
    """Check files against their sha256; without names all that are there. Exit code 1 if bad."""
    store = _store(folder)
    models = [store.model(name) for name in names or []]
    bad = 0
    for model in models or [model for model in store.models if store.is_present(model)]:
        for file, state in store.verify(model).items():
            typer.echo(f"{state}  {model.name}  {file}")
            bad += state is not FileState.GOOD
    if bad:
        raise typer.Exit(1)


def _store(folder: Path | None) -> ModelStore:
    return ModelStore(folder or default_folder(os.environ))


def _pull_one(store: ModelStore, model: VisionModel) -> list[Path]:
    """Fetch a network behind a progress bar, which a terminal alone shows."""
    console = Console(stderr=True)
    if not console.is_terminal:
        return store.pull(model)
    columns = (*Progress.get_default_columns(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(model.name, total=model.size_bytes)
        return store.pull(model, lambda done, _: bar.update(task, completed=done))
