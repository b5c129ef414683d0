"""The Dockerfile keeps its promises: pinned, small, not root, and nothing fetched past pip."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
Instruction = tuple[str, str]


def instructions(text: str) -> list[Instruction]:
    """Return each instruction's name and what follows it, comments and line ends taken out."""
    lines = [line for line in text.splitlines() if not line.lstrip().startswith("#")]
    joined = re.sub(r"\\\n\s*", "", "\n".join(lines))
    parts = [line.split(maxsplit=1) for line in joined.splitlines() if line.strip()]
    return [(name, rest) for name, rest in parts]


@pytest.fixture(scope="module")
def stages() -> list[list[Instruction]]:
    found: list[list[Instruction]] = []
    for instruction in instructions((ROOT / "Dockerfile").read_text("utf-8")):
        if instruction[0] == "FROM":
            found.append([])
        found[-1].append(instruction)
    return found


def said(stage: list[Instruction], name: str) -> list[str]:
    return [rest for word, rest in stage if word == name]


def allowed() -> set[str]:
    """What `.dockerignore` lets into the build."""
    lines = (ROOT / ".dockerignore").read_text("utf-8").splitlines()
    assert "*" in lines, "everything is left out at first"
    return {line[1:] for line in lines if line.startswith("!")}


def test_both_stages_start_from_one_image_of_a_full_version(
    stages: list[list[Instruction]],
) -> None:
    images = [said(stage, "FROM")[0].split()[0] for stage in stages]
    assert len(images) == 2
    assert len(set(images)) == 1, "the environment is copied: its Python must be the same"
    assert re.fullmatch(r"python:3\.\d+\.\d+-slim-\w+", images[0])
    wanted = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    image_python = re.search(r"3\.\d+", images[0])
    assert f"Programming Language :: Python :: {image_python[0]}" in wanted["classifiers"]


def test_nothing_but_pip_reaches_the_network(stages: list[list[Instruction]]) -> None:
    text = (ROOT / "Dockerfile").read_text("utf-8")
    assert not re.search(r"^ADD|https?://|curl|wget|git clone", text, re.MULTILINE)
    for command in said(stages[0], "RUN"):
        if "pip install" in command:
            assert "-c constraints.txt" in command, "the versions that were tested"
            assert "--no-cache-dir" in command


def test_what_flies_is_not_root_and_is_our_command(stages: list[list[Instruction]]) -> None:
    names = [name for name, _ in stages[-1]]
    assert said(stages[-1], "USER") == ["follower"]
    assert "RUN" not in names[names.index("USER") :]
    (command,) = json.loads(said(stages[-1], "ENTRYPOINT")[0])
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["scripts"]
    assert Path(command).name in scripts
    assert command.startswith(said(stages[-1], "COPY")[0].split()[-1]), "it was copied"
    assert said(stages[-1], "STOPSIGNAL") == ["SIGTERM"], "on which the vehicle is held"


def test_it_is_built_from_what_the_wheel_is_made_of_and_that_is_let_in(
    stages: list[list[Instruction]],
) -> None:
    assert said(stages[0], "COPY") == [". ."]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    needed = {Path(path).parts[0] for path in (*wheel["packages"], *wheel["force-include"])}
    needed |= {project["project"]["readme"], *project["project"]["license-files"]}
    assert needed | {"pyproject.toml", "constraints.txt"} == allowed()
    for name in allowed():
        assert (ROOT / name).exists()


@pytest.mark.slow
def test_an_engine_finds_nothing_to_object_to() -> None:
    docker = shutil.which("docker")
    if docker is None or subprocess.run([docker, "info"], capture_output=True).returncode:
        pytest.skip("needs a Docker engine")
    checked = subprocess.run(
        [docker, "build", "--check", str(ROOT)], capture_output=True, text=True, timeout=200
    )
    assert checked.returncode == 0, checked.stdout + checked.stderr
