"""Networks load, or say in one line why not; a network can be given another input size."""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
from onnxruntime.capi import onnxruntime_pybind11_state as ort_errors
from program import kept_by_importing

from follower_vision import onnx_network
from follower_vision.models import ModelStore
from follower_vision.onnx_network import (
    ModelError,
    Network,
    Tensor,
    onnx_session,
    with_input_size,
)

onnx = pytest.importorskip("onnx", reason="tiny networks are built with the onnx package")
h = onnx.helper


def averaging_network(side: int = 32) -> bytes:
    """Average each 4x4 block; 'value_info' states a size, as simplified networks do."""
    nodes = [
        h.make_node("AveragePool", ["pixels"], ["half"], kernel_shape=[2, 2], strides=[2, 2]),
        h.make_node("AveragePool", ["half"], ["quarter"], kernel_shape=[2, 2], strides=[2, 2]),
    ]

    def tensor(name: str, size: int) -> object:
        return h.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [1, 3, size, size])

    graph = h.make_graph(
        nodes,
        "average",
        [tensor("pixels", side)],
        [tensor("quarter", side // 4)],
        value_info=[tensor("half", side // 2)],
    )
    model = h.make_model(graph, opset_imports=[h.make_opsetid("", 13)], ir_version=8)
    return bytes(model.SerializeToString())


@pytest.fixture
def averaging_file(tmp_path: Path) -> Path:
    path = tmp_path / "average.onnx"
    path.write_bytes(averaging_network())
    return path


@pytest.mark.slow
def test_onnxruntime_reports_nothing_and_keeps_no_identifier(tmp_path: Path) -> None:
    assert kept_by_importing("follower_vision.onnx_network", tmp_path) == []


def test_network_tells_its_inputs_and_computes(averaging_file: Path) -> None:
    network = Network(averaging_file)
    assert network.inputs == {"pixels": (1, 3, 32, 32)}
    assert network.outputs == {"quarter": (1, 3, 8, 8)}
    pixels = np.random.default_rng(1).random((1, 3, 32, 32), dtype=np.float32)
    expected = pixels.reshape(1, 3, 8, 4, 8, 4).mean(axis=(3, 5))
    np.testing.assert_allclose(network.run(pixels)[0], expected, rtol=1e-5)


def test_weights_in_a_file_beside_the_network_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As torch.onnx.export writes them, wherever the program was begun."""
    ends = [h.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [400]) for name in "ab"]
    weights = onnx.numpy_helper.from_array(np.arange(400, dtype=np.float32), "w")
    graph = h.make_graph(
        [h.make_node("Add", ["a", "w"], ["b"])], "add", ends[:1], ends[1:], [weights]
    )
    model = h.make_model(graph, opset_imports=[h.make_opsetid("", 13)], ir_version=8)
    (tmp_path / "nets").mkdir()
    path = tmp_path / "nets" / "add.onnx"
    onnx.save(model, path, save_as_external_data=True, location="add.onnx.data", size_threshold=0)
    monkeypatch.chdir(tmp_path)
    for named in (path, Path("nets/add.onnx")):
        (sums,) = Network(named).run(np.ones(400, np.float32))
        np.testing.assert_array_equal(sums, np.arange(400) + 1)


def test_session_has_one_thread_that_does_not_spin(averaging_file: Path) -> None:
    options = onnx_session(averaging_file).get_session_options()
    assert options.intra_op_num_threads == 1
    assert options.get_session_config_entry("session.intra_op.allow_spinning") == "0"


def test_missing_file_names_the_pull_command(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"absent\.onnx: no such network.*follower models pull"):
        Network(tmp_path / "absent.onnx")


@pytest.mark.parametrize("content", [b"", b"not a network", averaging_network()[:-40]])
def test_broken_file_is_one_line_with_the_file_name(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "broken.onnx"
    path.write_bytes(content)
    with pytest.raises(ModelError, match=r"broken\.onnx: not a network") as caught:
        Network(path)
    assert "\n" not in str(caught.value)
    assert "follower models pull" in str(caught.value)


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads every file")
def test_unreadable_file(averaging_file: Path) -> None:
    averaging_file.chmod(stat.S_IWUSR)
    with pytest.raises(ModelError, match="cannot read this network"):
        Network(averaging_file)


def test_tensor_of_another_shape_is_refused(averaging_file: Path) -> None:
    with pytest.raises(ModelError, match=r"average\.onnx: .*\(1, 3, 16, 16\)") as caught:
        Network(averaging_file).run(np.zeros((1, 3, 16, 16), np.float32))
    assert "\n" not in str(caught.value)


def test_half_precision_inputs_are_refused(tmp_path: Path) -> None:
    half = [h.make_tensor_value_info(name, onnx.TensorProto.FLOAT16, [4]) for name in "ab"]
    graph = h.make_graph([h.make_node("Relu", ["a"], ["b"])], "relu", half[:1], half[1:])
    model = h.make_model(graph, opset_imports=[h.make_opsetid("", 14)], ir_version=8)
    path = tmp_path / "half.onnx"
    path.write_bytes(model.SerializeToString())
    with pytest.raises(ModelError, match=r"half\.onnx: input a is a tensor\(float16\)"):
        Network(path)


@pytest.mark.parametrize("side", [4, 16, 127, 128, 300])
def test_resized_network_computes_the_same_on_another_size(tmp_path: Path, side: int) -> None:
    network = Network(
        tmp_path / "resized.onnx", content=with_input_size(averaging_network(), (1, 3, side, side))
    )
    same = Network(tmp_path / "same.onnx", content=averaging_network(side))
    assert network.inputs == same.inputs
    pixels = np.random.default_rng(2).random((1, 3, side, side), dtype=np.float32)
    np.testing.assert_array_equal(network.run(pixels)[0], same.run(pixels)[0])


def test_resized_network_keeps_everything_else() -> None:
    model = onnx.load_model_from_string(with_input_size(averaging_network(), (1, 3, 16, 16)))
    original = onnx.load_model_from_string(averaging_network())
    assert list(model.graph.node) == list(original.graph.node)
    assert model.opset_import == original.opset_import


@pytest.mark.parametrize("content", [b"\x3a\x7f", b"\x3b", b"\x80", b"text, no network"])
def test_resizing_something_else_says_so(content: bytes) -> None:
    with pytest.raises(ValueError, match="no ONNX file"):
        with_input_size(content, (1, 3, 8, 8))


def test_two_inputs_cannot_be_resized() -> None:
    tensors = [h.make_tensor_value_info(name, 1, [4]) for name in "abc"]
    graph = h.make_graph([h.make_node("Add", ["a", "b"], ["c"])], "add", tensors[:2], tensors[2:])
    with pytest.raises(ValueError, match="2 inputs"):
        with_input_size(h.make_model(graph).SerializeToString(), (8,))


OTHER = "openvino"
"""Whichever is here, these tests give it to onnxruntime's processor, and change its answers."""


class OtherSession:
    """A session of another device: the processor's, off by `error`, which fails when told to."""

    def __init__(self, inner: Any, error: float) -> None:
        self._inner, self._error = inner, error
        self.broken = False
        self.runs = 0

    def run(self, names: None, feeds: dict[str, Tensor]) -> list[Tensor]:
        self.runs += 1
        if self.broken:
            raise ort_errors.RuntimeException("the device is gone")
        return [tensor + self._error for tensor in self._inner.run(names, feeds)]


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the verdicts, empty and this test's alone."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "follower" / "devices"


@pytest.fixture
def other_device(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], list[OtherSession]]:
    def have(error: float) -> list[OtherSession]:
        opened: list[OtherSession] = []

        def open_session(
            path: Path, content: bytes | None = None, name: str = onnx_network.CPU
        ) -> Any:
            session = onnx_session(path, content)
            if name == onnx_network.CPU:
                return session
            opened.append(OtherSession(session, error))
            return opened[-1]

        monkeypatch.setattr(onnx_network, "onnx_session", open_session)
        return opened

    return have


def test_a_device_that_answers_alike_is_used_until_it_fails(
    averaging_file: Path,
    other_device: Callable[[float], list[OtherSession]],
    caplog: pytest.LogCaptureFixture,
) -> None:
    opened = other_device(1e-4)
    network = Network(averaging_file, OTHER)
    assert network.device == OTHER
    pixels = np.ones((1, 3, 32, 32), np.float32)
    np.testing.assert_array_equal(network.run(pixels)[0], np.float32(1) + np.float32(1e-4))
    opened[0].broken = True
    np.testing.assert_array_equal(network.run(pixels)[0], 1.0)  # the same frame, by the processor
    assert network.device == onnx_network.CPU
    network.run(pixels)
    (said,) = caplog.messages
    assert "average.onnx failed on openvino" in said
    assert "the device is gone" in said


class FailingProvider:
    """What onnxruntime's session in Python stands before, once its execution provider fails."""

    def __init__(self, inner: Any) -> None:
        self._inner = inner

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def run(self, *_: object) -> None:
        raise ort_errors.EPFail("the device is gone")


@pytest.fixture
def second_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let onnxruntime itself open the other device: as its processor once more."""
    real = onnx_network.provider_of
    monkeypatch.setattr(onnx_network, "provider_of", lambda _: real(onnx_network.CPU))


@pytest.mark.usefixtures("second_processor")
def test_onnxruntime_does_not_go_on_with_another_device_by_itself(
    averaging_file: Path, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    """It prints, and what was never compared would answer under the failed device's name."""
    network = Network(averaging_file, OTHER)
    assert network.device == OTHER
    network._accelerated._sess = FailingProvider(network._accelerated._sess)
    np.testing.assert_array_equal(network.run(np.ones((1, 3, 32, 32), np.float32))[0], 1.0)
    assert network.device == onnx_network.CPU
    assert "average.onnx failed on openvino" in caplog.text
    assert capfd.readouterr().out == ""


@pytest.mark.usefixtures("second_processor")
def test_a_device_whose_library_does_not_load_gives_way_to_the_processor(
    averaging_file: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    real, opened = onnxruntime.InferenceSession._create_inference_session, []

    def create(session: Any, *given: object) -> None:
        opened.append(session)
        real(session, *given)
        if len(opened) == 2:
            raise RuntimeError("its library could not be loaded\nand so on")

    monkeypatch.setattr(onnxruntime.InferenceSession, "_create_inference_session", create)
    assert Network(averaging_file, OTHER).device == onnx_network.CPU
    said = "openvino does not start here (its library could not be loaded)"
    assert caplog.messages == [f"average.onnx runs on the processor: {said}"]


def test_a_device_that_answers_otherwise_is_not_used(
    averaging_file: Path,
    other_device: Callable[[float], list[OtherSession]],
    caplog: pytest.LogCaptureFixture,
) -> None:
    other_device(0.1)
    network = Network(averaging_file, OTHER)
    assert network.device == onnx_network.CPU
    assert "other answers than the processor's (quarter)" in caplog.text


@pytest.fixture
def free_file(tmp_path: Path) -> Path:
    """A network that takes pictures of any size from 8 pixels on, as exported with free sizes."""

    def tensor(name: str, *sides: str) -> object:
        return h.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["n", "c", *sides])

    node = h.make_node("AveragePool", ["pixels"], ["means"], kernel_shape=[8, 8])
    graph = h.make_graph([node], "any", [tensor("pixels", "h", "w")], [tensor("means", "y", "x")])
    path = tmp_path / "free.onnx"
    onnx.save(h.make_model(graph, opset_imports=[h.make_opsetid("", 13)], ir_version=8), path)
    return path


@pytest.mark.parametrize(("error", "device"), [(1e-4, OTHER), (0.1, onnx_network.CPU)])
def test_a_network_of_free_sizes_is_compared_with_a_picture(
    free_file: Path,
    other_device: Callable[[float], list[OtherSession]],
    error: float,
    device: str,
) -> None:
    other_device(error)
    network = Network(free_file, OTHER)
    assert (network.device, network.inputs) == (device, {"pixels": (0, 0, 0, 0)})
    assert "other answers" in network.refusals.get(OTHER, "other answers")


@pytest.fixture
def auto_tries_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `auto` find the other device, and no real one."""
    monkeypatch.setattr(onnx_network, "accelerators", lambda _: (OTHER,))


def test_what_answered_alike_is_not_compared_again(
    averaging_file: Path, other_device: Callable[[float], list[OtherSession]], cache: Path
) -> None:
    opened = other_device(1e-4)
    assert [Network(averaging_file, OTHER).device for _ in range(2)] == [OTHER, OTHER]
    assert [session.runs for session in opened] == [1, 0]
    (kept,) = cache.iterdir()
    assert kept.name.startswith(hashlib.sha256(averaging_file.read_bytes()).hexdigest())
    assert kept.name.endswith(f"-{onnxruntime.__version__}-{OTHER}.txt")
    averaging_file.write_bytes(averaging_network(64))  # another network under the same name
    Network(averaging_file, OTHER)
    assert opened[-1].runs == 1


@pytest.mark.usefixtures("auto_tries_it")
def test_auto_does_not_try_again_what_was_refused_but_its_name_does(
    averaging_file: Path,
    other_device: Callable[[float], list[OtherSession]],
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO")
    opened = other_device(0.1)
    for _ in range(2):
        network = Network(averaging_file, onnx_network.AUTO)
        assert network.device == onnx_network.CPU
        assert network.refusals == {OTHER: "other answers than the processor's (quarter)"}
    assert len(opened) == 1
    assert len(caplog.messages) == 2
    mended = other_device(1e-4)  # say, by a new driver
    assert Network(averaging_file, onnx_network.AUTO).device == onnx_network.CPU
    assert Network(averaging_file, OTHER).device == OTHER
    assert Network(averaging_file, onnx_network.AUTO).device == OTHER
    assert [session.runs for session in mended] == [1, 0]


@pytest.mark.usefixtures("auto_tries_it")
def test_a_device_that_does_not_start_is_tried_each_time(averaging_file: Path, cache: Path) -> None:
    if onnx_network.provider_of(OTHER):
        pytest.skip("it starts here")
    assert Network(averaging_file, onnx_network.AUTO).device == onnx_network.CPU
    assert not cache.exists()


@pytest.mark.parametrize("kept", [b"", b"same", b"\xff\xfe", b"same answers or not"])
def test_a_verdict_that_cannot_be_read_is_made_anew(
    averaging_file: Path,
    other_device: Callable[[float], list[OtherSession]],
    cache: Path,
    kept: bytes,
) -> None:
    opened = other_device(1e-4)
    Network(averaging_file, OTHER)
    (file,) = cache.iterdir()
    file.write_bytes(kept)
    assert Network(averaging_file, OTHER).device == OTHER
    assert [session.runs for session in opened] == [1, 1]
    assert file.read_text("utf-8") == "same answers"


def test_a_cache_that_cannot_be_written_changes_nothing(
    averaging_file: Path,
    other_device: Callable[[float], list[OtherSession]],
    cache: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cache.parents[1].write_text("a file is where the folder should be")
    opened = other_device(1e-4)
    assert [Network(averaging_file, OTHER).device for _ in range(2)] == [OTHER, OTHER]
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(averaging_file))
    assert Network(averaging_file, OTHER).device == OTHER
    assert [session.runs for session in opened] == [1, 1, 1]


def test_a_device_that_is_not_here_gives_way_to_the_processor_with_a_warning(
    averaging_file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (absent, *_) = (name for name in onnx_network.DEVICES[2:] if not onnx_network.provider_of(name))
    assert Network(averaging_file, absent).device == onnx_network.CPU
    assert caplog.messages == [
        "average.onnx runs on the processor: the onnxruntime that is installed has no " + absent
    ]


def test_a_device_that_nobody_knows_is_refused(averaging_file: Path) -> None:
    with pytest.raises(ValueError, match="there is no device 'gpu'; there are auto, cpu, tensorrt"):
        Network(averaging_file, "gpu")


def test_tensorrt_keeps_its_engines_beside_the_network(tmp_path: Path) -> None:
    kept = onnx_network.provider_options("tensorrt", tmp_path)["trt_engine_cache_path"]
    assert Path(kept).parent == tmp_path
    assert onnx_network.provider_options("cuda", tmp_path) == {}


@pytest.mark.skipif(not onnx_network.provider_of("openvino"), reason="needs onnxruntime-openvino")
def test_openvino_runs_the_networks_that_come_along() -> None:
    for name in ("follower-detector.onnx", "follower-re3.onnx"):
        assert Network(ModelStore(Path("none")).file(name), "openvino").device == "openvino"
