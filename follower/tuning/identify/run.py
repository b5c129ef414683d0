"""`follower identify`: read, fit, print, write."""

import shlex
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from follower.recording.run_folder import new_run_folder
from follower.tuning.identify.readers import (
    Recording,
    VehicleAxis,
    read_flight,
    read_px4_log,
    read_steps,
)
from follower.tuning.identify.result import (
    VEHICLE_FILE,
    Identification,
    Spread,
    delay_named,
    load_vehicle,
    model_row,
    write_identification,
)
from follower.ui.terminal.console import print_line
from follower_control.common.strict_config import SettingsError
from follower_control.tuning.fit import ResponseFit, SizeFit, fit_response, fit_size
from follower_control.tuning.response_model import ResponseData, TooLittleError

REPORT = "identification.html"
_POOR, _DOUBTFUL = 0.5, 0.8


def identify(sources: Sequence[Path], out: Path, report: bool, command: str) -> None:
    """Identify a vehicle, and write the result and its report.

    Args:
        sources: folders of flights, PX4 logs, CSV files of steps.
        out: folder in which the run gets its own.
        report: write the report with its plots.
        command: the command line, for the report.

    Raises:
        SettingsError: nothing can be identified from any of the recordings.
    """
    console = Console()
    with console.status("Reading and fitting"):
        found = identification([read_recording(path) for path in sources])
    folder = new_run_folder(out, "identify")
    path = folder / VEHICLE_FILE
    path.write_text(found.to_yaml(), "utf-8")
    _print(console, found)
    files = [path]
    if report:
        files.append(write_identification(folder / REPORT, found, command))
    for file in files:
        print_line(console, str(file))
    print_line(console, _next(path, found))


def _next(path: Path, found: Identification) -> str:
    poor = [axis for axis, fit in found.fits.items() if fit.held_out_fit < _POOR]
    if poor:
        return f"Next: follower excite, for better data of {', '.join(poor)}"
    try:
        load_vehicle(path).model()
    except SettingsError as error:
        return f"`follower tune` cannot take it: {error}"
    return f"Next: follower tune {shlex.quote(str(path))}"


def read_recording(path: Path) -> Recording:
    """Read a flight's folder, a PX4 log or a CSV file of steps.

    Raises:
        SettingsError: it is neither.
        FlightFileError: it is a folder without a flight.
        TelemetryError: it is a log that cannot be used.
    """
    if not path.exists():
        raise SettingsError(f"{path}: there is no such file or folder")
    try:
        if path.is_dir() or path.suffix == ".mcap":
            return read_flight(path if path.is_dir() else path.parent)
        if path.suffix == ".csv":
            return read_steps(path)
        if path.suffix == ".ulg":
            return read_px4_log(path)
    except TooLittleError as error:
        raise SettingsError(f"{path}: {error}") from None
    raise SettingsError(f"{path}: give flights' folders, PX4 logs (.ulg), or CSV files of steps")


def identification(recordings: Sequence[Recording]) -> Identification:
    """Fit everything that the recordings of one vehicle contain.

    Raises:
        SettingsError: nothing can be fitted; the message says why.
    """
    remarks = [remark for one in recordings for remark in one.remarks]
    fits: dict[VehicleAxis, ResponseFit] = {}
    data: dict[VehicleAxis, Sequence[ResponseData]] = {}
    for axis in VehicleAxis:
        records = _chosen(recordings, axis)
        try:
            fits[axis] = fit_response(records, axis.least_excitation)
            data[axis] = records
        except TooLittleError as error:
            remarks.append(f"{axis}: {error}" if records else f"{axis}: nothing moved this axis")
    delays, size = _delays(recordings), _size(recordings, remarks)
    if not fits and not delays and size is None:
        raise SettingsError("nothing can be identified: " + "; ".join(remarks))
    remarks += [
        f"{axis}: the model explains only {100 * fit.held_out_fit:.0f} % of what it was not "
        f"fitted to: {_advice(fit.held_out_fit)}"
        for axis, fit in fits.items()
        if fit.held_out_fit < _DOUBTFUL
    ]
    if pursued := [axis for axis in fits if not _excited(recordings, axis)]:
        remarks.append(
            f"{', '.join(pursued)}: fitted to pursuits, in which setpoints depend on the vehicle's "
            "answer and all axes move at once: gain and dead time can be wrong in spite of a good "
            "fit; fly `follower excite`"
        )
    sources = tuple(one.name for one in recordings)
    return Identification(sources, fits, data, delays, size, tuple(remarks))


def _advice(held_out_fit: float) -> str:
    if held_out_fit < _POOR:
        return "do not tune by it without reading the report"
    return "read the report before you tune by it"


def _chosen(recordings: Sequence[Recording], axis: VehicleAxis) -> list[ResponseData]:
    """Return what to fit an axis to: identification flights, else pursuits.

    In a pursuit the axes move together, and a velocity in a turning nose's frame is more than one
    axis' answer.
    """
    wanted = _excited(recordings, axis)
    return [
        record
        for one in recordings
        if one.is_excitation is wanted
        for record in one.axes.get(axis, ())
    ]


def _excited(recordings: Sequence[Recording], axis: VehicleAxis) -> bool:
    """Whether an identification flight moved an axis."""
    return any(one.is_excitation and one.axes.get(axis) for one in recordings)


def _delays(recordings: Sequence[Recording]) -> dict[str, Spread]:
    every = {
        "camera_s": [value for one in recordings for value in one.camera_delays_s],
        "frame_interval_s": [value for one in recordings for value in one.frame_intervals_s],
        "position_s": [max(value, 0.0) for one in recordings for value in one.position_ages_s],
    }
    found = {name: Spread.of(values) for name, values in every.items()}
    return {name: spread for name, spread in found.items() if spread is not None}


def _size(recordings: Sequence[Recording], remarks: list[str]) -> SizeFit | None:
    samples = [sample for one in recordings for sample in one.sizes]
    if not samples:
        return None
    try:
        return fit_size([s.size_rad for s in samples], [s.range_m for s in samples])
    except TooLittleError as error:
        remarks.append(f"target: {error}")
        return None


def _print(console: Console, found: Identification) -> None:
    head = ("Axis", "Order", "Gain", "Dead time", "Time const.", "Damping", "Rate limit")
    table = Table(*head, box=None, pad_edge=False)
    table.add_column("Held-out fit", justify="right")
    for axis, fit in found.fits.items():
        row = model_row(axis, fit)
        table.add_row(*(Text(cell.partition(" (")[0]) for cell in row))
    console.print(table)
    for name, spread in found.delays.items():
        print_line(
            console,
            f"{delay_named(name)}: median {1e3 * spread.median.value:.0f} ms, 95 % below "
            f"{1e3 * spread.most:.0f} ms",
        )
    if found.size is not None:
        size = found.size.size_m
        print_line(console, f"target_size_m: {size.value:.2f} ({size.low:.2f} to {size.high:.2f})")
    for remark in found.remarks:
        print_line(console, remark)
