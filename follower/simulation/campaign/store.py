"""The rows of a campaign on disk: one line a finished run, never lost, never half."""

import fcntl
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import fields
from pathlib import Path
from typing import Any

from follower.simulation.campaign.metrics import RunMetrics
from follower.ui.terminal.console import needed
from follower_control.common.strict_config import SettingsError
from follower_vision.disk import write_whole_bytes

ROWS = "runs.jsonl"
RESULTS = "results.parquet"


class RunStore(AbstractContextManager["RunStore"]):
    """Appends rows to a file; each is on the disk when `add` returns.

    Args:
        folder: is made where it does not exist; only one campaign at a time may write into it.

    Raises:
        SettingsError: another one does.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / ROWS
        self._file = self.path.open("ab")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._file.close()
            text = f"{folder}: a campaign is running there; give another --out"
            raise SettingsError(text) from None
        self.rows = read_rows(self.path)
        if self.path.read_bytes()[-1:] not in (b"", b"\n"):  # a line that is cut off
            self._file.write(b"\n")

    def __exit__(self, *_error: object) -> None:
        with suppress(OSError):  # of a row for which there was no room, as `add` has said
            self._file.close()

    def has(self, key: str) -> bool:
        """Whether a run was flown and has every figure; its row may be from before one was."""
        row = self.rows.get(key, {"error": "not flown"})
        return not row["error"] and set(RunMetrics.__dataclass_fields__) <= set(row)

    def add(self, row: Mapping[str, Any]) -> None:
        """Keep a run's row; one of the same key takes the last one's place.

        Raises:
            OSError: it cannot be written; `filename` is the file's.
        """
        line = json.dumps(row, allow_nan=False, separators=(",", ":")) + "\n"
        try:
            self._file.write(line.encode("utf-8"))
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise type(error)(error.errno, error.strerror, str(self.path)) from None
        self.rows[str(row["key"])] = dict(row)


def read_rows(path: Path) -> dict[str, dict[str, Any]]:
    """Return the rows of a file by their keys; a line that is cut off or no row is left out."""
    rows: dict[str, dict[str, Any]] = {}
    if not path.exists():
        return rows
    for line in path.read_bytes().splitlines():
        try:
            row = json.loads(line)
        except ValueError:  # the computer stopped while it was written
            continue
        if isinstance(row, dict) and {"key", "error"} <= set(row):
            rows[str(row["key"])] = row
    return rows


_COLUMNS = {
    **dict.fromkeys(("key", "scenario", "autopilot", "vision", "command"), "str"),
    **dict.fromkeys(("version", "error"), "str"),
    **dict.fromkeys(("number", "seed"), "int"),
    **{field.name: str(field.type).removesuffix(" | None") for field in fields(RunMetrics)},
    "wall_s": "float",
    "failures": "tuple[str, ...]",
    "passed": "bool",
}
"""The columns of each campaign's results, whatever came of its runs, and what they hold."""


def write_parquet(path: Path, rows: Sequence[dict[str, Any]]) -> Path:
    """Write one line a run; the campaign's parameters are columns that begin with "p_".

    The file appears whole or not at all. A parameter of several types becomes text.

    Raises:
        OSError: it cannot be written.
    """
    pa, pq = needed("pyarrow"), needed("pyarrow.parquet")
    kinds = {"str": pa.string(), "int": pa.int64(), "float": pa.float64(), "bool": pa.bool_()}
    kinds |= {"tuple[str, ...]": pa.list_(pa.string())}
    kinds |= dict.fromkeys(
        ("tuple[float, ...]", "tuple[float | None, ...]"), pa.list_(pa.float64())
    )
    columns = {name: pa.array([row.get(name) for row in rows], kinds[kind])
               for name, kind in _COLUMNS.items()}  # fmt: skip
    for name in rows[0]["values"]:
        columns[f"p_{name}"] = pa.array(_alike([row["values"][name] for row in rows]))
    content = pa.BufferOutputStream()
    pq.write_table(pa.table(columns), content)
    return write_whole_bytes(path, content.getvalue().to_pybytes())


def _alike(values: Sequence[Any]) -> list[Any]:
    """Return truths and numbers as they are, and anything else, or both, as text."""
    kinds = {type(one) for one in values}
    kind = bool if kinds == {bool} else float if kinds <= {int, float} else str
    return [kind(one) for one in values]
