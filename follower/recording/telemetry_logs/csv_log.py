"""Telemetry as a table of text, for logs of any other kind."""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from follower.recording.telemetry_logs.samples import TelemetryError, TelemetrySamples

TIME = "time_s"
ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")
RATES = ("roll_rate_deg_s", "pitch_rate_deg_s", "yaw_rate_deg_s")
PLACE = ("north_m", "east_m", "down_m", "north_m_s", "east_m_s", "down_m_s")
MODE = "mode"


def read_csv(path: Path) -> TelemetrySamples:
    """Read a table with a head.

    Columns: time_s, roll_deg, pitch_deg, yaw_deg; if there are: roll_rate_deg_s, pitch_rate_deg_s,
    yaw_rate_deg_s (of the body, from the gyro); north_m, east_m, down_m, north_m_s, east_m_s,
    down_m_s; mode. Others are passed over. An empty cell says nothing.

    Raises:
        TelemetryError: a column is missing, or a cell is no number.
    """
    samples = TelemetrySamples()
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            has_rates = _check(path, reader.fieldnames or ())
            for number, row in enumerate(reader, 2):
                _take(samples, row, has_rates, f"{path}, line {number}")
    except (UnicodeDecodeError, csv.Error) as error:
        raise TelemetryError(f"{path}: this is no table of text ({error})") from error
    return samples


def _check(path: Path, columns: Sequence[str]) -> bool:
    missing = [name for name in (TIME, *ANGLES) if name not in columns]
    if missing:
        raise TelemetryError(
            f"{path}: the column {missing[0]} is missing; needed are "
            f"{', '.join((TIME, *ANGLES))}, and there are {', '.join(columns) or 'none'}"
        )
    return all(name in columns for name in RATES)


def _take(
    samples: TelemetrySamples, row: Mapping[str, str | None], has_rates: bool, place: str
) -> None:
    time_s = _number(row, TIME, place)
    angles = [math.radians(_number(row, name, place)) for name in ANGLES]
    if math.isfinite(sum(angles)):
        samples.attitudes.append((time_s, *angles))
        if has_rates:
            rates = tuple(math.radians(_number(row, name, place)) for name in RATES)
            samples.attitude_rates.append(rates)
    if all(row.get(name) for name in PLACE):
        samples.positions.append((time_s, *(_number(row, name, place) for name in PLACE)))
    mode = (row.get(MODE) or "").strip()
    if mode:
        samples.add_mode(time_s, mode, True)


def _number(row: Mapping[str, str | None], name: str, place: str) -> float:
    text = (row.get(name) or "").strip()
    try:
        return float(text) if text else math.nan
    except ValueError:
        raise TelemetryError(f"{place}: {name} is no number, but {text!r}") from None
