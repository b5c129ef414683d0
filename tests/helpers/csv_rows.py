"""What a program has written as a table."""

import csv
from pathlib import Path


def rows_of(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file, each by the names in its heading."""
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))
