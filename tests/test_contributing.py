"""The worked examples of CONTRIBUTING.md: they are short, and they work."""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from csv_rows import rows_of
from program import MAIN, run_from
from small_scenario import NEAR_CAR

ROOT = Path(__file__).parent.parent
SOURCES = ("follower", "vision", "control", "sim", "configs", "tests/conftest.py", "pyproject.toml")
CONTRACT = "tests/follower/links/test_link_contract.py"
PART = re.compile(
    r"^`(?P<path>[^`\n]+)`(?:, a new file)?:$|^```(\w+)\n(?P<block>.*?)^```", re.M | re.S
)
MOST_LINES, MOST_FILES = 25, 3
FAILED = 1
"""What `follower sim` returns if the pursuit is not as its scenario wants it."""


class Change(NamedTuple):
    """One block: a new file's text, or lines of a file before and after."""

    path: str
    language: str
    block: str

    def lines(self, *marks: str) -> str:
        chosen = (line for line in self.block.splitlines() if line.startswith(marks))
        return "".join(f"{line[1:]}\n" for line in chosen)

    @property
    def added(self) -> int:
        text = self.block if self.language == "python" else self.lines("+")
        return sum(map(bool, text.splitlines()))

    def apply(self, root: Path) -> None:
        path = root / self.path
        if self.language == "python":
            assert not path.exists()
            path.write_text(self.block, "utf-8")
            return
        text, before = path.read_text("utf-8"), self.lines(" ", "-")
        assert text.count(before) == 1, f"{self.path} has other lines than this:\n{before}"
        path.write_text(text.replace(before, self.lines(" ", "+")), "utf-8")


def changes(title: str) -> Iterator[Change]:
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    section = text.partition(f"### {title}\n")[2].partition("\n### ")[0]
    path = ""
    for part in PART.finditer(section):
        path = part["path"] or path
        if part["block"]:
            yield Change(path, part[2], part["block"])


class Copy:
    """The sources with an example's changes, run from there."""

    def __init__(self, root: Path, title: str) -> None:
        self.root = root
        for name in (*SOURCES, "tests/helpers", CONTRACT):
            source, copy = ROOT / name, root / name
            copy.parent.mkdir(parents=True, exist_ok=True)
            if source.is_dir():
                shutil.copytree(source, copy, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(source, copy)
        made = list(changes(title))
        for change in made:
            change.apply(root)
        self.touched = {change.path for change in made}
        self.added = sum(change.added for change in made)

    def run(self, *arguments: str, codes: tuple[int, ...] = (0,)) -> str:
        return run_from(self.root, *arguments, cwd=self.root, codes=codes).stdout

    def follower(self, *arguments: str, codes: tuple[int, ...] = (0,)) -> str:
        return self.run("-c", MAIN, *arguments, codes=codes)


@pytest.fixture
def example(request: pytest.FixtureRequest, tmp_path: Path) -> Copy:
    copy = Copy(tmp_path, request.param)
    assert 0 < copy.added <= MOST_LINES
    assert 0 < len(copy.touched) <= MOST_FILES
    sources = [path for path in copy.touched if path.endswith(".py")]
    copy.run("-m", "ruff", "check", *sources)
    copy.run("-m", "ruff", "format", "--check", *sources)
    return copy


pytestmark = pytest.mark.slow


@pytest.mark.parametrize("example", ["A motion tracker"], indirect=True)
def test_the_motion_tracker_tracks_a_clip(example: Copy) -> None:
    clip = example.root / "clip"
    clip.mkdir()
    patch = cv2.resize(np.random.default_rng(6).integers(0, 256, (5, 5, 3), np.uint8), (40, 40))
    for number in range(12):
        image = np.full((240, 320, 3), 90, np.uint8)
        image[80:120, 60 + 5 * number : 100 + 5 * number] = patch
        cv2.imwrite(str(clip / f"{number:03}.png"), image)
    assert "template" in example.follower("trackers").splitlines()
    boxes = example.root / "boxes.csv"
    asked = ("--target", "60,80,40,40", "--tracker", "template", "--boxes", str(boxes))
    example.follower("track", str(clip), *asked, "--no-video")
    assert boxes.read_text("utf-8").splitlines()[-1].startswith("11,0.366667,115.000,80.000")


@pytest.mark.parametrize("example", ["A follow mode"], indirect=True)
def test_the_follow_mode_flies(example: Copy) -> None:
    scenario = example.root / "near.yaml"
    scenario.write_text(NEAR_CAR, "utf-8")
    example.follower(
        "sim",
        str(scenario),
        *("--lockstep", "--vision", "truth+noise", "--no-video", "--no-record"),
        *("--set", "servo.mode=leash"),
        codes=(0, FAILED),
    )
    (written,) = (example.root / "runs").glob("*/setpoints.csv")
    rows = [row for row in rows_of(written) if row["state"] == "following"]
    assert len(rows) > 100
    assert min(float(row["forward_m_s"]) for row in rows) == 0.0


@pytest.mark.parametrize("example", ["A link"], indirect=True)
def test_the_link_keeps_the_contract(example: Copy) -> None:
    kept = example.run("-m", "pytest", "-n0", "-q", CONTRACT, "-m", "not slow", "-k", "redundant")
    assert "4 passed" in kept


@pytest.mark.parametrize("example", ["A fault"], indirect=True)
def test_the_fault_is_listed_and_flown(example: Copy) -> None:
    assert "frames-dark" in example.follower("faults", "list")
    assert "1 case, 0 failed" in example.follower("faults", "frames-dark", "--autopilot", "px4")
