"""`follower models`: the networks that the tracker and the detector run on."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import DownloadColumn, Progress, TransferSpeedColumn
from rich.table import Table

from follower.ui.terminal.console import check_extra
from follower_control.common.strict_config import SettingsError
from follower_vision.models import FileState, ModelStore, VisionModel, default_folder

if TYPE_CHECKING:
    from follower_vision.evaluation.one_pass import Sequence

models_app = typer.Typer(
    help="List, fetch, verify and quantise the networks.",
    no_args_is_help=True,
    rich_markup_mode=None,
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
        table.add_column(heading, overflow="fold", no_wrap=heading == "name")
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


@models_app.command()
def quantise(
    name: Annotated[
        str, typer.Argument(help="A name as `list` shows it, or the path of a network.")
    ],
    int8: Annotated[
        bool, typer.Option("--int8/--fp16", help="To which numbers its own are reduced.")
    ] = True,
    sequences: Annotated[
        list[Path] | None,
        typer.Option(
            help="Judge on your own sequences, as `follower evaluate` reads them, in place of the "
            "simulator's; may be given several times."
        ),
    ] = None,
    folder: Folder = None,
) -> None:
    """Make a smaller form of a network and measure both side by side; needs the extra `train`.

    Writes NAME.int8.onnx or NAME.fp16.onnx with a card. Flights take it in the network's place
    (`vision.precision: auto`) if success and AUC fall by less than 0.005 and it is 1.1 times as
    fast. INT8 is calibrated on films of the simulator. A network given by its path is only written.
    """
    check_extra("quantising", "train", "onnx")
    from follower.training.quantise import Precision, find_reducible, reduce_network
    from follower_vision.evaluation.datasets import DatasetError

    store = _store(folder)
    network = find_reducible(name, store)
    precision = Precision.INT8 if int8 else Precision.FP16
    console = Console(stderr=True)
    try:
        judged_on = _usable(sequences or [])
        with console.status(name) as status:
            made = reduce_network(network, precision, judged_on, tell=status.update)
    except DatasetError as error:
        raise SettingsError(f"--sequences: {error}") from None
    figures = made.figures
    table = Table(caption=figures.on, show_edge=False, pad_edge=False)
    for heading in (name, "success", "AUC", "precision", "speed"):
        table.add_column(heading)
    for row, score, speed in (
        ("original", figures.original, 1.0),
        (precision, figures.reduced, figures.speed),
    ):
        values = (score.success, score.auc, score.precision)
        table.add_row(row, *(f"{value:.3f}" for value in values), f"{speed:.2f}")
    Console().print(table)
    for path in (*made.files, made.card):
        typer.echo(str(path))
    if name not in [model.name for model in store.models]:
        typer.echo("taken where its path is given")
        return
    for path, reduced in zip(network.files, made.files, strict=True):
        (store.withhold if figures.refusal else store.prefer)(path, reduced)
    typer.echo(f"not taken: {figures.refusal}" if figures.refusal else "taken by default")


def _usable(folders: list[Path]) -> list[Sequence]:
    """Return the sequences of some folders; none only if there are no folders.

    Raises:
        DatasetError: there is none that a tracker can be judged on.
    """
    from follower_vision.evaluation.datasets import DatasetError, load_dataset

    found: list[Sequence] = []
    remarks: list[str] = []
    for folder in folders:
        sequences, said = load_dataset(folder)
        found += [one for one in sequences if any(one.truth[1:])]
        remarks += said
    if folders and not found:
        raise DatasetError("; ".join(["no sequence can be used", *remarks]))
    return found


def _store(folder: Path | None) -> ModelStore:
    return ModelStore(folder or default_folder())


def _pull_one(store: ModelStore, model: VisionModel) -> list[Path]:
    """Fetch a network behind a progress bar, which a terminal alone shows."""
    console = Console(stderr=True)
    if not console.is_terminal:
        return store.pull(model)
    columns = (*Progress.get_default_columns(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(model.name, total=model.size_bytes)
        return store.pull(model, lambda done, _: bar.update(task, completed=done))
