"""The folder that each run gets."""

import os
from pathlib import Path

import pytest

from follower.recording.run_folder import new_run_folder


@pytest.mark.parametrize("letter", ["n", "名"])
def test_a_recording_of_the_longest_name_gets_folders_of_its_own(
    tmp_path: Path, letter: str
) -> None:
    stem = letter * (251 // len(letter.encode()))
    folders = [new_run_folder(tmp_path, f"track-{stem}") for _ in range(2)]
    assert [folder.name[-3:] for folder in folders] == [letter * 3, f"{letter}-2"]
    (tmp_path / f"{folders[1].name}-inspection.html").touch()
    assert len(os.fsencode(folders[0].name)) > 190
