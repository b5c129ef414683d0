"""The results of all cases that were flown, in one file that grows from run to run."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from follower.faults.verdict import Figures, Verdict
from follower.report.writer import write_whole


@dataclass(frozen=True, slots=True)
class Result:
    """One case: which flight, and what came of its fault."""

    flavour: str
    link: str
    realtime: bool
    verdict: Verdict

    @property
    def key(self) -> str:
        """What tells it from other cases."""
        how = "real time" if self.realtime else "lockstep"
        return f"{self.verdict.fault}, {self.flavour}, {self.link}, {how}"


class Results:
    """Cases by their keys; a case flown anew takes the old one's place.

    Args:
        path: the JSON file; read if it exists.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._cases: dict[str, Result] = {}
        if path.exists():
            for case in json.loads(path.read_text("utf-8")):
                self._put(_read(case))

    def __iter__(self) -> Iterator[Result]:
        return iter(self._cases.values())

    def __len__(self) -> int:
        return len(self._cases)

    def add(self, result: Result) -> None:
        """Take a case and write the file.

        Raises:
            OSError: it cannot be written.
        """
        self._put(result)
        self._path.parent.mkdir(parents=True, exist_ok=True)
        cases = [asdict(one) for one in self]
        write_whole(self._path, json.dumps(cases, indent=1) + "\n")

    def _put(self, result: Result) -> None:
        self._cases[result.key] = result


def _read(case: dict[str, object]) -> Result:
    verdict = case["verdict"]
    if not isinstance(verdict, dict):
        raise TypeError(f"this is no case of a fault: {case}")
    figures = Figures(**verdict.pop("figures"))
    failures = tuple(verdict.pop("failures"))
    return Result(
        flavour=str(case["flavour"]),
        link=str(case["link"]),
        realtime=bool(case["realtime"]),
        verdict=Verdict(failures=failures, figures=figures, **verdict),
    )
