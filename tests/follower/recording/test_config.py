"""What a recording says it was made with."""

from pathlib import Path

import pytest

from follower.recording.config import model_hashes
from follower.settings.settings import load_settings
from follower_vision.models import MODELS
from follower_vision.models.download import sha256_of
from follower_vision.models.store import EMBEDDED_FOLDER

SUMS = {file.name: file.sha256 for model in MODELS for file in model.files}


@pytest.mark.parametrize(
    ("tracker", "detector", "files"),
    [
        ("re3", "embedded", ("re3", "detector")),
        (
            "siamese-correlation",
            "follower-detector",
            ("siamese_backbone", "siamese_head", "detector"),
        ),
        (
            f"{EMBEDDED_FOLDER}/follower-siamese_head.onnx",
            None,
            ("siamese_backbone", "siamese_head"),
        ),
        (f"{EMBEDDED_FOLDER}/follower-re3.onnx", None, ("re3",)),
        ("correlation", None, ()),
        ("nanotrack-v3", "embedded", ("detector",)),  # the tracker's networks are not there
    ],
)
def test_the_networks_of_a_flight_are_known_by_their_sums(
    tracker: str,
    detector: str | None,
    files: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("FOLLOWER_MODELS", str(tmp_path))
    settings = load_settings(overrides=[f"tracker={tracker}", f"detector={detector or 'null'}"])
    names = [f"follower-{file}.onnx" for file in files]
    assert model_hashes(settings) == {name: SUMS[name] for name in names}


def test_a_fitted_model_of_ones_own_counts_too(tmp_path: Path) -> None:
    own = tmp_path / "fitted.json"
    own.write_text("{}")
    settings = load_settings(overrides=[f"fusion.model={own}", "tracker=correlation"])
    assert model_hashes(settings) == {"fitted.json": sha256_of(own)}
