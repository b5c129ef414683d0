"""Packages with entry points, as pip leaves them, made by hand."""

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

TRACKER = """
import numpy as np
from follower_vision.geometry.box import Box
from follower_vision.trackers.motion_tracker import MotionEstimate

class Follows:
    name = "follows"
    def start(self, image, box):
        self.box = box
    def update(self, image):
        return MotionEstimate(self.box, 1.0)
"""

FAILS_LATE = """
class Fails(Follows):
    calls = 0
    def update(self, image):
        self.calls += 1
        if self.calls > 10:
            {fault}
        return MotionEstimate(self.box, 1.0)

def make(find_file, device):
    return Fails()
"""


class Site:
    """A folder of installed packages."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.modules: list[str] = []

    def add(self, package: str, group: str, name: str, code: str) -> None:
        """Install a package whose module's `make` is added under a name."""
        module = package.replace("-", "_")
        self.modules.append(module)
        (self.folder / f"{module}.py").write_text(code, "utf-8")
        info = self.folder / f"{module}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[follower.{group}]\n{name} = {module}:make\n")

    def imported(self) -> list[str]:
        """Return the packages' modules that are imported."""
        return [module for module in self.modules if module in sys.modules]


@contextmanager
def installed(folder: Path) -> Iterator[Site]:
    """Give a site that Python finds for as long as this is entered."""
    folder.mkdir()
    site = Site(folder)
    sys.path.insert(0, str(folder))
    try:
        yield site
    finally:
        sys.path.remove(str(folder))
        for module in site.imported():
            del sys.modules[module]


def warnings_in(caplog: pytest.LogCaptureFixture) -> list[str]:
    """Return the warnings that were logged."""
    return [record.message for record in caplog.records if record.levelno >= logging.WARNING]
