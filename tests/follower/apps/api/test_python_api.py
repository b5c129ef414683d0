"""What `import follower` offers: its examples, its size, and that it changes as CHANGELOG says."""

from __future__ import annotations

import doctest
import re
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from flying_vehicle import flying_vehicle, write_square
from program import python
from public_surface import SURFACE, current_surface, read_surface

import follower

ROOT = Path(__file__).parents[4]
PAGE = ROOT / "docs" / "reference" / "python-api.md"
TUTORIAL = ROOT / "docs" / "tutorials" / "python.md"
DRONE = {
    "camera": {"fov_deg": 70, "pitch_deg": -20},
    "link": {"vehicle_id": 1},
    "servo": {"max_forward_m_s": 2},
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the examples name: videos, a sequence with its boxes, settings, a recorded flight."""
    folder = tmp_path_factory.mktemp("examples")
    write_square(folder / "clip.mp4", 2)
    write_square(folder / "camera.mp4", 60)
    (folder / "drone.yaml").write_text(yaml.safe_dump(DRONE), "utf-8")
    shutil.copytree(ROOT / "tests" / "golden" / "chase", folder / "runs" / "demo")
    images = folder / "otb" / "patch" / "img"
    images.mkdir(parents=True)
    rng = np.random.default_rng(1)
    patch = cv2.resize(rng.integers(0, 255, (6, 6, 3)).astype(np.uint8), (24, 24))
    for number in range(12):
        image = np.full((120, 160, 3), 90, np.uint8)
        image[40:64, 20 + 5 * number : 44 + 5 * number] = patch
        cv2.imwrite(str(images / f"{number:04}.png"), image)
    boxes = "\n".join(f"{20 + 5 * number},40,24,24" for number in range(12))
    (images.parent / "groundtruth.txt").write_text(boxes)
    return folder


def test_the_surface_is_small_and_each_name_has_an_example() -> None:
    assert len(follower.__all__) <= 25
    for name in follower.__all__:
        assert ">>> import " in example_of(name), name


def example_of(name: str) -> str:
    """Return the docstring with the example: the package's own for its version."""
    return (follower if name == "__version__" else getattr(follower, name)).__doc__ or ""


@pytest.mark.slow
@pytest.mark.parametrize("name", follower.__all__)
def test_the_example_does_what_it_says(
    name: str,
    files: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    free_port: Callable[[], int],
) -> None:
    for file in files.iterdir():
        copy = shutil.copytree if file.is_dir() else shutil.copy
        copy(file, tmp_path / file.name)
    monkeypatch.chdir(tmp_path)
    text, flies = example_of(name), "Pursuit(" in example_of(name)
    port = free_port() if flies else 0
    here = text.replace("14540", str(port)).replace("camera=0", 'camera="camera.mp4"')
    test = doctest.DocTestParser().get_doctest(here, {}, name, None, None)
    assert test.examples
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS, verbose=False)
    said: list[str] = []
    if flies:
        with flying_vehicle("px4", port, 12.0) as vehicle:
            vehicle.each_step = lambda _: vehicle.autopilot.switch_mode(vehicle.setpoint_mode)
            runner.run(test, out=said.append)
    else:
        runner.run(test, out=said.append)
    assert runner.failures == 0, "".join(said)


@pytest.mark.slow
def test_the_tutorial_runs_and_its_pictures_are_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = TUTORIAL.read_text("utf-8")
    names: dict[str, Any] = {}
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert len(blocks) == len(re.findall("^## ", text, re.MULTILINE)) == 3
    for block in blocks:
        exec(compile(block, str(TUTORIAL), "exec"), names)
    assert names["track"].state == "tracking"
    assert names["flown"].score.in_frame_share > 0.9
    for name in re.findall(r"pictures/python-([\w.]+)", text):
        assert (tmp_path / name).stat().st_size > 10_000


def test_a_name_that_is_not_there_and_what_dir_lists() -> None:
    with pytest.raises(AttributeError, match="no attribute 'Fussion'"):
        _ = follower.Fussion  # type: ignore[attr-defined]
    assert set(follower.__all__) <= set(dir(follower))


@pytest.mark.slow
def test_importing_it_loads_nothing_that_is_not_asked_for() -> None:
    modules = python("import sys, follower; print(*sys.modules)").split()
    assert {name for name in modules if name.startswith("follower")} == {"follower"}
    assert {"cv2", "typer", "onnxruntime", "importlib.metadata"}.isdisjoint(modules)


def test_the_page_documents_each_name_where_it_lives() -> None:
    first = PAGE.read_text("utf-8").partition("\n## follower_vision")[0]
    named = set(re.findall(r"^::: (\S+)$", first, re.MULTILINE))
    homes = {
        f"{thing.__module__}.{name}"
        for name in follower.__all__
        if name != "__version__"
        for thing in [getattr(follower, name)]
    }
    assert named == homes


def test_the_surface_has_changed_only_where_the_changelog_says_so() -> None:
    version, recorded = read_surface()
    present = current_surface()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert version == project["version"], f"a release: python {SURFACE.with_suffix('.py')}"
    notes = (ROOT / "CHANGELOG.md").read_text("utf-8").partition("\n## [Unreleased]\n")[2]
    unreleased = notes.partition("\n## [")[0]
    sections = dict(re.findall(r"^### (\w+)\n(.*?)(?=^### |\Z)", unreleased, re.M | re.S))
    for name in sorted(recorded.keys() | present.keys()):
        if recorded.get(name) == present.get(name):
            continue
        kind = (
            ("Added" if name not in recorded else "Removed")
            if ((name in recorded) != (name in present))
            else "Changed"
        )
        assert f"`{name}`" in sections.get(kind, ""), (
            f"{name} differs from {SURFACE.name}: name it in CHANGELOG.md, [Unreleased], {kind}"
        )


def test_every_name_stands_in_the_changelog() -> None:
    notes = (ROOT / "CHANGELOG.md").read_text("utf-8")
    assert [name for name in follower.__all__ if f"follower.{name}" not in notes] == []


def test_a_target_that_is_neither_box_nor_text_is_refused_in_words() -> None:
    with pytest.raises(follower.SettingsError, match=r"give a Box, .* not \(320, 180, 40, 30\)"):
        follower.Fusion((320, 180, 40, 30))  # type: ignore[arg-type]
