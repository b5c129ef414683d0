"""The rows of a campaign as Parquet."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from follower.campaign.extra import needed

RESULTS = "results.parquet"


def write_parquet(path: Path, rows: Sequence[dict[str, Any]]) -> Path:
    """Write one line a run; the campaign's parameters are columns that begin with "p_".

    The file appears whole or not at all. A parameter of several types becomes text.
    """
    pa, pq = needed("pyarrow"), needed("pyarrow.parquet")
    names = dict.fromkeys(name for row in rows for name in row if name != "values")
    columns = {name: pa.array([row.get(name) for row in rows], _types(pa).get(name))
               for name in names}  # fmt: skip
    for name in dict.fromkeys(name for row in rows for name in row["values"]):
        columns[f"p_{name}"] = pa.array(_alike([row["values"].get(name) for row in rows]))
    draft = path.with_name(f".{path.name}.part")
    pq.write_table(pa.table(columns), draft)
    draft.replace(path)
    return path


def _types(pa: Any) -> dict[str, Any]:
    times = pa.list_(pa.float64())
    return {"occlusion_s": times, "reacquired_s": times, "failures": pa.list_(pa.string())}


def _alike(values: Sequence[Any]) -> list[Any]:
    """Return numbers as they are, and anything else as text."""
    is_number = all(isinstance(one, int | float) or one is None for one in values)
    if is_number:
        return [None if one is None else float(one) for one in values]
    return [None if one is None else str(one) for one in values]
