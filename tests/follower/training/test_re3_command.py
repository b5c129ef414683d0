"""`follower train re3`, interrupted, resumed and exported: what a training's folder holds."""

from __future__ import annotations

from pathlib import Path

import pytest
from csv_rows import rows_of
from program import output_of

from follower.training.command import export_command
from follower.training.settings import find_device
from follower.training.trainer import save_checkpoint
from follower.ui.terminal.console import check_extra
from follower_control.common.strict_config import SettingsError
from follower_vision.trackers.re3 import Re3Network

RECIPE = """
name: tiny
licence: Apache-2.0
training:
  network: {channels: 16, hidden: 16, head: 16}
  stages: [{steps: 2, batch: 2}, {steps: 1, batch: 2, unroll: 2}]
  validate_every: 2
  validation_scenes: 2
  validation_frames: 3
  save_every: 1
"""


@pytest.mark.slow
def test_a_training_leaves_all_that_is_needed(tmp_path: Path) -> None:
    recipe = tmp_path / "tiny.yaml"
    recipe.write_text(RECIPE, encoding="utf-8")
    output_of("train", "re3", "--config", str(recipe), "--out", str(tmp_path), "--device", "cpu")
    folder = tmp_path / "tiny"
    made = {path.name for path in folder.iterdir()}
    wanted = {"config.yaml", "checkpoint.pt", "samples.png", "log.csv", "tiny.onnx", "tiny.md"}
    assert made >= wanted
    rows = rows_of(folder / "log.csv")
    assert [row["step"] for row in rows] == ["1", "2", "3"]
    assert [row["stage"] for row in rows] == ["0", "0", "1"]
    assert rows[1]["overlap"]
    network = Re3Network(folder / "tiny.onnx")
    assert network.first_state.hidden.shape == (2, 1, 16)
    assert "Apache-2.0" in (folder / "tiny.md").read_text(encoding="utf-8")

    card = (folder / "tiny.md").read_text(encoding="utf-8")
    (folder / "tiny.onnx").unlink()
    output = output_of("export", str(folder))
    sha256 = output.split("sha256 ")[1].strip()
    assert sha256 in card
    assert (folder / "tiny.onnx").is_file()

    assert "tiny.onnx" in output_of("train", "re3", "--resume", str(folder), "--device", "cpu")


def test_a_resumed_training_takes_no_other_recipe(tmp_path: Path) -> None:
    folder, same, other = tmp_path / "tiny", tmp_path / "same.yaml", tmp_path / "other.yaml"
    folder.mkdir()
    for path in (folder / "config.yaml", same):
        path.write_text(RECIPE, encoding="utf-8")
    other.write_text(RECIPE.replace("steps: 2", "steps: 3"), encoding="utf-8")
    command = ("train", "re3", "--resume", str(folder), "--config")
    with pytest.raises(SettingsError, match=r"checkpoint\.pt: there is no such file"):
        output_of(*command, str(same))
    said = f"--config {other}: this training goes on with {folder}/config.yaml"
    with pytest.raises(SettingsError, match=said):
        output_of(*command, str(other))


def test_a_resumed_training_stays_in_its_folder_and_keeps_its_weights(tmp_path: Path) -> None:
    folder = tmp_path / "tiny"
    folder.mkdir()
    (folder / "config.yaml").write_text(RECIPE, encoding="utf-8")
    elsewhere = tmp_path / "elsewhere"
    said = f"--out {elsewhere}: this training goes on in {folder}"
    with pytest.raises(SettingsError, match=said):
        output_of("train", "re3", "--resume", str(folder), "--out", str(elsewhere))
    assert not elsewhere.exists()
    with pytest.raises(SettingsError, match=r"checkpoint\.pt: there is no such file"):
        output_of("train", "re3", "--resume", str(folder), "--out", str(tmp_path))
    with pytest.raises(SettingsError, match="--start other: this training goes on with its own"):
        output_of("train", "detector", "--resume", str(folder), "--start", "other")


@pytest.mark.parametrize("kind", ["re3", "siamese", "detector"])
def test_a_training_is_not_written_over(kind: str, tmp_path: Path) -> None:
    folder = tmp_path / f"follower-{kind}"
    folder.mkdir()
    save_checkpoint(folder, {"kind": kind, "step": 900})
    before = (folder / "checkpoint.pt").read_bytes()
    said = f"{folder}: a training is there already: go on with it by --resume {folder}, or give"
    with pytest.raises(SettingsError, match=said):
        output_of("train", kind, "--out", str(tmp_path))
    assert (folder / "checkpoint.pt").read_bytes() == before
    assert list(folder.iterdir()) == [folder / "checkpoint.pt"]


@pytest.mark.parametrize(("kind", "option"), [("re3", "--pictures"), ("detector", "--data")])
def test_a_training_that_cannot_begin_leaves_no_folder(
    kind: str, option: str, tmp_path: Path
) -> None:
    with pytest.raises(SettingsError, match="no-pictures"):
        output_of("train", kind, option, "no-pictures", "--out", str(tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_only_a_motion_trackers_training_is_exported(tmp_path: Path) -> None:
    save_checkpoint(tmp_path, {"kind": "detector"})
    with pytest.raises(SettingsError, match="this is no training of a motion tracker"):
        export_command(tmp_path)


@pytest.mark.slow
def test_sequences_are_written_where_evaluate_finds_them(tmp_path: Path) -> None:
    output_of("train", "sequences", str(tmp_path / "out"), "--count", "2", "--frames", "3")
    assert len(list((tmp_path / "out").glob("generated_*/img/*.jpg"))) == 6


@pytest.mark.parametrize("name", ["gpu", "meta", "mps", "cuda:9"])
def test_a_device_that_is_not_here_is_refused_before_the_training(name: str) -> None:
    with pytest.raises(SettingsError, match=f"--device {name}: torch has none here"):
        find_device(name)
    assert find_device("cpu").type == "cpu"


def test_without_the_extra_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("follower.ui.terminal.console.find_spec", lambda _: None)
    with pytest.raises(SettingsError, match=r"in the clone: pip install -e '\.\[train\]'"):
        check_extra("training", "train", "torch", "onnx")
