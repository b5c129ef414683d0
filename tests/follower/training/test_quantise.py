"""`follower models quantise`: smaller networks, judged beside their originals, or one line."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
from program import kept_by_importing
from typer.testing import CliRunner

from follower.apps.models import models_app
from follower.flight.vision.tracker_factory import make_settings_detector
from follower.recording.config import model_hashes
from follower.settings.settings import load_settings
from follower.training import quantise
from follower.training.quantise import (
    Comparison,
    Films,
    Precision,
    Reduced,
    find_reducible,
    reduce_file,
    reduce_network,
    render_sequences,
)
from follower_control.common.strict_config import SettingsError
from follower_vision.detection.onnx_detector import OnnxDetector
from follower_vision.evaluation.metrics import OpeScore
from follower_vision.evaluation.one_pass import Sequence, read_image
from follower_vision.models import ModelStore
from follower_vision.models.download import sha256_of
from follower_vision.models.store import EMBEDDED_FOLDER
from follower_vision.onnx_network import ModelError, Network
from follower_vision.trackers.re3 import Re3Network

DETECTOR, RE3 = "follower-detector", "follower-re3"
FILMS = Films(seed=3, starts_s=(5.0,), frames=3, scenarios=["winding"])


@pytest.mark.slow
def test_onnxruntimes_tools_report_nothing_and_keep_no_identifier(tmp_path: Path) -> None:
    assert kept_by_importing("follower.training.quantise", tmp_path) == []


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> list[Sequence]:
    return render_sequences(FILMS, tmp_path_factory.mktemp("film"))


def quantise_command(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(models_app, ["quantise", *arguments], catch_exceptions=False)
    return result.exit_code, " ".join(result.output.split())


def op_types(path: Path) -> set[str]:
    return {node.op_type for node in onnx.load(path).graph.node}


@pytest.mark.slow
@pytest.mark.parametrize("precision", Precision)
def test_a_reduced_detector_finds_what_the_original_finds(
    precision: Precision, film: list[Sequence], tmp_path: Path
) -> None:
    store = ModelStore(tmp_path / "models")
    made = reduce_network(find_reducible(DETECTOR, store), precision, film, film)
    (path,) = made.files
    assert path == tmp_path / "models" / f"{DETECTOR}.{precision}.onnx"
    assert path.stat().st_size < 0.6 * store.file(f"{DETECTOR}.onnx").stat().st_size
    assert {"QuantizeLinear", "DequantizeLinear"} <= op_types(path) or precision == "fp16"
    original = OnnxDetector(store.file(f"{DETECTOR}.onnx"))
    reduced = OnnxDetector(path)
    assert reduced.class_names == original.class_names
    image = read_image(film[0].images[-1])
    wanted, found = (one.detect(image)[0] for one in (original, reduced))
    assert found.class_name == wanted.class_name == "car"
    assert found.box.iou(wanted.box) > 0.8
    assert found.score == pytest.approx(wanted.score, abs=0.1)
    card = made.card.read_text("utf-8")
    assert f"{made.figures.original.success:.3f}, {made.figures.reduced.success:.3f}" in card
    assert "Apache-2.0" in card


@pytest.mark.slow
def test_re3_with_its_seven_inputs_is_quantised_too(film: list[Sequence], tmp_path: Path) -> None:
    network = find_reducible(RE3, ModelStore(tmp_path))
    made = reduce_network(network, Precision.INT8, film, film)
    assert made.figures.reduced.success == made.figures.original.success == 1.0
    Re3Network(made.files[0])
    assert not Network.listeners
    with pytest.raises(ModelError, match="quantised already"):
        reduce_network(find_reducible(str(made.files[0]), ModelStore(tmp_path)), "int8", film, film)


def test_a_network_that_names_other_operators_first_is_quantised_too(tmp_path: Path) -> None:
    h, whole, small = onnx.helper, tmp_path / "a.onnx", tmp_path / "a.int8.onnx"
    ends = [h.make_tensor_value_info(name, 1, [1, 1, 4, 4]) for name in "ab"]
    kernel = onnx.numpy_helper.from_array(np.ones((1, 1, 1, 1), np.float32), "kernel")
    nodes = [h.make_node("Conv", ["a", "kernel"], ["c"]), h.make_node("Add", ["a", "c"], ["b"])]
    graph = h.make_graph(nodes, "sum", ends[:1], ends[1:], [kernel])
    domains = [h.make_opsetid("ai.onnx.ml", 3), h.make_opsetid("", 17)]
    onnx.save(h.make_model(graph, opset_imports=domains, ir_version=8), whole)
    reduce_file(whole, Precision.INT8, [{"a": np.ones((1, 1, 4, 4), np.float32)}], small)
    assert "QuantizeLinear" in op_types(small)


def test_films_are_the_same_each_time(film: list[Sequence], tmp_path: Path) -> None:
    (again,) = render_sequences(FILMS, tmp_path)
    assert again.truth == film[0].truth
    for one, other in zip(again.images, film[0].images, strict=True):
        assert one.read_bytes() == other.read_bytes()


@pytest.mark.slow
def test_the_command_writes_into_the_users_folder_and_says_its_verdict(
    film: list[Sequence], tmp_path: Path
) -> None:
    sequences = film[0].images[0].parents[2]
    folder = tmp_path / "models"
    code, said = quantise_command(
        DETECTOR, "--fp16", "--sequences", str(sequences), "--folder", str(folder)
    )
    assert code == 0
    names = {path.name for path in folder.iterdir()}
    assert names >= {f"{DETECTOR}.fp16.onnx", f"{DETECTOR}.fp16.md"}
    assert (f"{DETECTOR}.preferred.json" in names) == ("taken by default" in said)
    assert "not taken: " in said or "taken by default" in said
    assert not (EMBEDDED_FOLDER / f"{DETECTOR}.fp16.onnx").exists()
    path = folder / f"{DETECTOR}.fp16.onnx"
    assert path.as_posix() in said.replace(" ", "")


def figures(success: float, speed: float, original: float = 0.9) -> Comparison:
    before, after = (OpeScore(value, value, value, 100) for value in (original, success))
    return Comparison(before, after, speed, "1 sequence")


def test_only_what_is_as_good_and_faster_is_taken_by_default() -> None:
    assert figures(0.896, 1.2).refusal == ""
    assert figures(0.95, 1.2).refusal == ""
    assert "success falls by 0.005" in figures(0.895, 1.2).refusal
    assert figures(0.9, 1.05).refusal == "it is 1.05 times as fast here, less than 1.1"
    assert "finds nothing on these sequences" in figures(0.0, 2.0, original=0.0).refusal


@pytest.fixture
def preferred(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The embedded detector's copy, with another score of its own, in its place."""
    monkeypatch.setenv("FOLLOWER_MODELS", str(tmp_path))
    original = EMBEDDED_FOLDER / f"{DETECTOR}.onnx"
    copy = tmp_path / f"{DETECTOR}.int8.onnx"
    model = onnx.load(original)
    onnx.helper.set_model_props(
        model, {entry.key: entry.value for entry in model.metadata_props} | {"names": "['a']"}
    )
    onnx.save(model, copy)
    ModelStore(tmp_path).prefer(original, copy)
    return copy


def flown(*overrides: str) -> Path:
    """The file that a flight with these settings runs its detector from."""
    detector = make_settings_detector(load_settings(overrides=[f"detector={DETECTOR}", *overrides]))
    return detector._network.path


def test_a_flight_takes_the_preferred_network_unless_told_not_to(preferred: Path) -> None:
    original = EMBEDDED_FOLDER / f"{DETECTOR}.onnx"
    assert flown() == preferred
    settings = load_settings(overrides=[f"detector={DETECTOR}"])
    assert model_hashes(settings) == {preferred.name: sha256_of(preferred)}
    assert flown("vision.precision=full") == original
    assert ModelStore(preferred.parent).file(f"{DETECTOR}.onnx") == original
    ModelStore(preferred.parent).withhold(original, preferred)
    assert flown() == original


@pytest.mark.parametrize("precision", Precision)
def test_a_network_that_is_not_taken_leaves_the_place_to_one_of_another_precision(
    preferred: Path, precision: Precision, monkeypatch: pytest.MonkeyPatch
) -> None:
    """INT8 was taken before; the network that is made now is worse."""
    made = preferred.with_name(f"{DETECTOR}.{precision}.onnx")
    worse = Reduced((made,), made.with_suffix(".md"), figures(0.8, 2.0))
    monkeypatch.setattr(quantise, "reduce_network", lambda *_, **__: worse)
    code, said = quantise_command(DETECTOR, f"--{precision}")
    assert code == 0
    assert "not taken: success falls" in said
    replaced = precision is Precision.INT8
    assert flown() == (EMBEDDED_FOLDER / f"{DETECTOR}.onnx" if replaced else preferred)


@pytest.mark.parametrize("harm", ["changed", "gone", "note"])
def test_a_preferred_network_that_was_changed_is_left_out_with_a_warning(
    preferred: Path, harm: str, caplog: pytest.LogCaptureFixture
) -> None:
    if harm == "changed":
        preferred.write_bytes(preferred.read_bytes() + b"\x00")
    elif harm == "gone":
        preferred.unlink()
    else:
        (preferred.parent / f"{DETECTOR}.preferred.json").write_text(json.dumps({"file": 3}))
    assert flown() == EMBEDDED_FOLDER / f"{DETECTOR}.onnx"
    assert DETECTOR in caplog.text


def test_opencvs_own_trackers_are_given_the_originals(tmp_path: Path) -> None:
    model = next(one for one in ModelStore(tmp_path).models if one.name == "vit")
    (tmp_path / model.files[0].name).write_bytes(b"")
    with pytest.raises(ModelError, match="run by OpenCV"):
        find_reducible("vit", ModelStore(tmp_path))


@pytest.mark.parametrize(
    "content", [b"", b"no network", (EMBEDDED_FOLDER / f"{RE3}.onnx").read_bytes()[:5000]]
)
def test_what_is_no_network_is_one_line_and_nothing_is_written(
    content: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "broken.onnx"
    path.write_bytes(content)
    with pytest.raises(ModelError, match=r"broken\.onnx: not a network") as raised:
        quantise_command(str(path))
    assert "\n" not in str(raised.value)
    assert list(tmp_path.iterdir()) == [path]


def test_a_network_of_another_kind_is_refused(tmp_path: Path) -> None:
    h = onnx.helper
    ends = [h.make_tensor_value_info(name, 1, [4]) for name in "ab"]
    graph = h.make_graph([h.make_node("Relu", ["a"], ["b"])], "relu", ends[:1], ends[1:])
    model = h.make_model(graph, opset_imports=[h.make_opsetid("", 17)], ir_version=8)
    onnx.save(model, tmp_path / "relu.onnx")
    with pytest.raises(ModelError, match="neither a detector that we read nor a Re3"):
        quantise_command(str(tmp_path / "relu.onnx"))


def test_a_folder_that_cannot_be_written_is_told_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "file").touch()

    def tell(what: str) -> None:
        raise AssertionError(what)

    network = find_reducible(DETECTOR, ModelStore(tmp_path / "file" / "models"))
    with pytest.raises(ModelError, match="file/models: cannot be written"):
        reduce_network(network, Precision.INT8, tell=tell)


def test_unknown_missing_and_unjudgeable_are_each_one_line(tmp_path: Path) -> None:
    for name, said in (
        ("nothing", "there is no network 'nothing'"),
        ("yolox-nano", "models pull yolox-nano"),
        (str(tmp_path / "gone.onnx"), "no such network"),
    ):
        with pytest.raises(ModelError, match=said):
            quantise_command(name, "--folder", str(tmp_path))
    with pytest.raises(SettingsError, match="--sequences"):
        quantise_command(DETECTOR, "--folder", str(tmp_path), "--sequences", str(tmp_path / "none"))
    assert list(tmp_path.iterdir()) == []


def test_sequences_without_a_usable_one_are_refused_not_replaced(
    film: list[Sequence], tmp_path: Path
) -> None:
    (tmp_path / "a").mkdir()
    for path in film[0].images:
        (tmp_path / "a" / path.name).write_bytes(path.read_bytes())
    for truth in ("1,2,3,4", "1,2,3,4\n0,0,0,0\n0,0,0,0"):
        (tmp_path / "a" / "groundtruth.txt").write_text(truth)
        with pytest.raises(SettingsError, match="--sequences: no sequence can be used"):
            quantise_command(DETECTOR, "--folder", str(tmp_path), "--sequences", str(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_what_onnxruntimes_tools_do_not_manage_is_one_line(
    film: list[Sequence], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise RuntimeError("no such operator\nand a trace")

    monkeypatch.setattr(quantise, "quantize_static", fails)
    with pytest.raises(ModelError, match=r"cannot be reduced: no such operator$"):
        reduce_network(find_reducible(DETECTOR, ModelStore(tmp_path)), Precision.INT8, film, film)
    assert list(tmp_path.iterdir()) == []


def test_without_onnx_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnx", None)
    monkeypatch.setattr("follower.ui.terminal.console.find_spec", lambda _: None)
    with pytest.raises(SettingsError, match=r"quantising needs onnx; .*\.\[train\]"):
        quantise_command(DETECTOR)


def test_old_recordings_mean_full_precision() -> None:
    from follower.settings.settings import as_recorded

    assert as_recorded({})["vision"]["precision"] == "full"
    assert as_recorded({"vision": {"precision": "auto"}})["vision"]["precision"] == "auto"
    assert np.isfinite(figures(0.9, 1.0).speed)
