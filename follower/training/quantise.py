"""Networks at reduced precision: made with onnxruntime's tools, judged beside their originals."""

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Protocol

import cv2
import onnx
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static
from onnxruntime.quantization.shape_inference import quant_pre_process
from onnxruntime.transformers.float16 import convert_float_to_float16

from follower.settings.settings import find_scenario
from follower_sim.camera import SimCamera
from follower_sim.chaser import Chaser
from follower_sim.scenario.scenario_file import load_scenario
from follower_sim.scoring.ground_truth import GroundTruth
from follower_sim.world.world import World
from follower_vision.detection import Detector
from follower_vision.detection.onnx_detector import OnnxDetector
from follower_vision.disk import can_be_written, write_whole, write_whole_bytes
from follower_vision.evaluation.datasets import load_dataset
from follower_vision.evaluation.metrics import OpeScore, mean_score, ope_score
from follower_vision.evaluation.one_pass import Sequence as ImageSequence
from follower_vision.evaluation.one_pass import start_box
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image
from follower_vision.models import ModelStore, Purpose
from follower_vision.models.download import sha256_of
from follower_vision.onnx_network import Feeds, ModelError, Network, path_of
from follower_vision.trackers.motion_tracker import MotionTracker
from follower_vision.trackers.opencv import OPENCV_KINDS
from follower_vision.trackers.re3 import Re3Network, Re3Tracker
from follower_vision.trackers.registry import TRACKERS, FindFile, make_tracker

MOST_LOSS = 0.005
"""A network whose success or AUC falls by this or more is never taken by default."""
LEAST_GAIN = 1.1
"""Nor is one that is less than so many times as fast: two runs differ by almost that."""
FILMED = ("avenue", "winding", "lookalike", "walker", "boat", "aerial", "orbit", "pursue-quadrotor")
"""Scenarios whose films calibrate and, from other times and worlds, judge; eight kinds of view."""
_INTERVAL_S = 0.1
_MOST_FEEDS = 64
_SIZE = {"width": 640, "height": 480, "drop_probability": 0.0}
_PER_CHANNEL_OPSET = 13
_STANDARD = ("", "ai.onnx")
"""The domain of ONNX's own operators, which need not be the first in a file."""
_QUANTISED = {"QuantizeLinear", "DequantizeLinear", "QLinearConv", "ConvInteger", "MatMulInteger"}


class Precision(StrEnum):
    """To what a network's numbers are reduced."""

    INT8 = "int8"
    FP16 = "fp16"


class Runner(Protocol):
    """A tracker or a detector on one sequence."""

    def start(self, image: Image, box: Box) -> None:
        """Begin at a target's box in the first image."""
        ...

    def follow(self, image: Image, truth: Box | None) -> Box | None:
        """Return the target's box in the next image; `truth` is for detectors alone."""
        ...


class TrackerRunner:
    """A motion tracker, which is told the first box alone."""

    def __init__(self, tracker: MotionTracker) -> None:
        self._tracker = tracker
        self.start = tracker.start

    def follow(self, image: Image, _truth: Box | None) -> Box | None:
        """See `Runner`."""
        return self._tracker.update(image).box


class DetectorRunner:
    """A detector; its answer is the detection that overlaps the truth most."""

    def __init__(self, detector: Detector) -> None:
        self._detector = detector

    def start(self, image: Image, box: Box) -> None:
        """See `Runner`: a detector remembers nothing."""

    def follow(self, image: Image, truth: Box | None) -> Box | None:
        """See `Runner`."""
        found = [one.box for one in self._detector.detect(image)]
        return max(found, key=truth.iou, default=None) if truth else None


@dataclass(frozen=True, slots=True)
class Reducible:
    """A tracker or detector whose networks can be replaced.

    Attributes:
        name: for the card.
        files: its networks.
        run: makes it, with what finds a file by its name.
        folder: where reduced networks go.
        licence: of the original.
    """

    name: str
    files: tuple[Path, ...]
    run: Callable[[FindFile], Runner]
    folder: Path
    licence: str = "the original's"


def find_reducible(name: str, store: ModelStore) -> Reducible:
    """Return what a name of `follower models list`, or the path of a network, stands for.

    Raises:
        ModelError: it is not there, broken, of no kind that we run, or run by OpenCV.
    """
    if name.endswith(".onnx"):
        path = path_of(name)
        return Reducible(path.stem, (path,), _kind(path), path.parent)
    model = store.model(name)
    files = tuple(store.paths(model))
    if model.purpose is Purpose.DETECTOR:

        def run(find: FindFile) -> Runner:
            return DetectorRunner(OnnxDetector(find(files[0].name), family=model.family))

        return Reducible(name, files, run, store.folder, model.licence)
    tracker = name.removeprefix("follower-")
    if tracker not in TRACKERS or tracker in OPENCV_KINDS:
        raise ModelError(f"{name} is run by OpenCV, which takes no reduced networks")
    return Reducible(
        name,
        files,
        lambda find: TrackerRunner(make_tracker(tracker, find)),
        store.folder,
        model.licence,
    )


def _kind(path: Path) -> Callable[[FindFile], Runner]:
    """Return how the network in a file of the user's own is run.

    Raises:
        ModelError: it is neither a detector nor a Re3 network.
    """

    def re3(find: FindFile) -> Runner:
        return TrackerRunner(Re3Tracker(Re3Network(find(path.name))))

    def detector(find: FindFile) -> Runner:
        return DetectorRunner(OnnxDetector(find(path.name)))

    Network(path)
    for run in (re3, detector):
        try:
            run(lambda _: path)
        except ModelError:
            continue
        return run
    raise ModelError(f"{path}: neither a detector that we read nor a Re3 network of ours")


@dataclass(frozen=True, slots=True)
class Films:
    """What is filmed of the simulator's targets: the same films, the same pictures.

    Attributes:
        seed: of the worlds.
        starts_s: when a film of each scenario begins, in the scenario's time.
        frames: how long each is.
        scenarios: their names.
    """

    seed: int
    starts_s: tuple[float, ...]
    frames: int
    scenarios: Sequence[str] = FILMED


TO_CALIBRATE = Films(seed=101, starts_s=(9.0,), frames=16)
TO_JUDGE = Films(seed=202, starts_s=(5.0, 20.0), frames=40)


def render_sequences(films: Films, folder: Path) -> list[ImageSequence]:
    """Write each film and its true boxes, in a layout that `follower evaluate` reads too."""
    for name in films.scenarios:
        scenario = load_scenario(find_scenario(name))
        camera = scenario.camera.model_copy(update=_SIZE)
        world = World(scenario.model_copy(update={"camera": camera, "seed": films.seed}))
        chaser, truth = Chaser(world), GroundTruth(world)
        for start_s in films.starts_s:
            place = folder / f"{name}-{start_s:.0f}s"
            (place / "img").mkdir(parents=True)
            source, lines = SimCamera(world, chaser), []
            for number in range(films.frames):
                time_s = source.next_capture_s = start_s + number * _INTERVAL_S
                delivery, box = source.capture(), truth.seen(time_s, chaser(time_s)).box
                if delivery is None:
                    raise RuntimeError(f"{name} loses frames")
                cv2.imwrite(str(place / f"img/{number:04}.jpg"), delivery.exposure.frame.image)
                lines.append("0,0,0,0" if box is None else ",".join(f"{v:.2f}" for v in box.xywh))
            (place / "groundtruth.txt").write_text("\n".join(lines), "utf-8")
    return load_dataset(folder)[0]


@dataclass(frozen=True, slots=True)
class Comparison:
    """What came of a network and its reduced form, side by side.

    Attributes:
        original: its score over all sequences.
        reduced: the other's.
        speed: how many times as fast the reduced one is, on this processor with one thread.
        on: what it was measured on, in words.
    """

    original: OpeScore
    reduced: OpeScore
    speed: float
    on: str

    @property
    def refusal(self) -> str:
        """Why the reduced network is not taken by default, "" if it is."""
        if not self.original.auc:
            return "the original itself finds nothing on these sequences"
        for measure in ("success", "auc"):  # the latter also tells where all targets are found
            lost = getattr(self.original, measure) - getattr(self.reduced, measure)
            if lost >= MOST_LOSS:
                return f"{measure} falls by {lost:.3f}, {MOST_LOSS} or more"
        if self.speed < LEAST_GAIN:
            return f"it is {self.speed:.2f} times as fast here, less than {LEAST_GAIN}"
        return ""


def compare(
    original: Callable[[], Runner], reduced: Callable[[], Runner], sequences: list[ImageSequence]
) -> Comparison:
    """Run both over the same pictures, in turn, so that another program's load meets both.

    Raises:
        DatasetError: a first box lies outside of its image.
        OSError: an image cannot be read.
    """
    seconds, scores = [0.0, 0.0], []
    for sequence in sequences:
        runners = original(), reduced()
        boxes: list[list[Box | None]] = [[sequence.initial], [sequence.initial]]
        for frame, (image, truth) in enumerate(zip(sequence.frames(), sequence.truth, strict=True)):
            for which in (0, 1) if frame % 2 else (1, 0):
                if frame == 0:
                    runners[which].start(image, start_box(sequence.initial, image))
                    continue
                began_s = time.perf_counter()
                boxes[which].append(runners[which].follow(image, truth))
                seconds[which] += time.perf_counter() - began_s
        scores.append([ope_score(one, sequence.truth) for one in boxes])
    first, second = (mean_score(column) for column in zip(*scores, strict=True))
    frames = sum(len(sequence.truth) for sequence in sequences)
    return Comparison(
        first, second, seconds[0] / seconds[1], f"{len(sequences)} sequences, {frames} frames"
    )


def inputs_of(network: Reducible, sequences: list[ImageSequence]) -> dict[str, list[Feeds]]:
    """Return, by file name, what each network is given on these sequences, `_MOST_FEEDS` at most.

    Of a network that runs with two input sizes those count that its file declares.
    """
    feeds: dict[str, list[Feeds]] = {path.name: [] for path in network.files}

    def listen(path: Path, given: Feeds) -> None:
        feeds[path.name].append({name: tensor.copy() for name, tensor in given.items()})

    with _listening(listen):
        for sequence in sequences:
            runner = network.run(_by_name(network.files))
            for frame, (image, truth) in enumerate(
                zip(sequence.frames(), sequence.truth, strict=True)
            ):
                if frame == 0:
                    runner.start(image, start_box(sequence.initial, image))
                else:
                    runner.follow(image, truth)
    return {path.name: _thinned(feeds[path.name], Network(path)) for path in network.files}


@contextmanager
def _listening(listener: Callable[[Path, Feeds], None]) -> Iterator[None]:
    Network.listeners.append(listener)
    try:
        yield
    finally:
        Network.listeners.remove(listener)


def _thinned(feeds: list[Feeds], network: Network) -> list[Feeds]:
    fitting = [one for one in feeds if all(_fits(one[n].shape, network.inputs[n]) for n in one)]
    return fitting[:: -(-len(fitting) // _MOST_FEEDS)]


def _fits(shape: tuple[int, ...], declared: tuple[int, ...]) -> bool:
    return all(want in (0, size) for size, want in zip(shape, declared, strict=True))


def _by_name(files: Sequence[Path]) -> FindFile:
    return {path.name: path for path in files}.__getitem__


class _Reader(CalibrationDataReader):  # type: ignore[misc]
    def __init__(self, feeds: list[Feeds]) -> None:
        self._feeds = iter(feeds)

    def get_next(self) -> Feeds | None:
        return next(self._feeds, None)


def reduce_file(path: Path, precision: Precision, feeds: list[Feeds], out: Path) -> None:
    """Write a network at reduced precision; its inputs and outputs stay float32.

    INT8 is static, as pairs of QuantizeLinear and DequantizeLinear, with a scale for each channel.

    Args:
        path: of the original.
        precision: to which.
        feeds: inputs by which INT8 is calibrated.
        out: is written.

    Raises:
        ModelError: it is reduced already, or onnxruntime's tools do not manage it.
    """
    model = onnx.load(path)
    if _QUANTISED & {node.op_type for node in model.graph.node}:
        raise ModelError(f"{path}: this network is quantised already")
    written = {entry.key: entry.value for entry in model.metadata_props}
    try:
        reduced = _halved(model) if precision is Precision.FP16 else _quantised(model, feeds)
    except (RuntimeError, ValueError, TypeError, KeyError, onnx.checker.ValidationError) as error:
        raise ModelError(f"{path}: cannot be reduced: {str(error).splitlines()[0]}") from error
    onnx.helper.set_model_props(reduced, {**written, "precision": str(precision)})
    write_whole_bytes(out, reduced.SerializeToString())


def _halved(model: onnx.ModelProto) -> Any:
    return convert_float_to_float16(model, keep_io_types=True)


def _quantised(model: onnx.ModelProto, feeds: list[Feeds]) -> Any:
    opset = max(one.version for one in model.opset_import if one.domain in _STANDARD)
    if opset < _PER_CHANNEL_OPSET:
        model = onnx.version_converter.convert_version(model, _PER_CHANNEL_OPSET)
    with tempfile.TemporaryDirectory() as folder:
        whole, prepared, out = (Path(folder, f"{name}.onnx") for name in ("a", "b", "c"))
        onnx.save(model, whole)
        quant_pre_process(whole, prepared, skip_symbolic_shape=True)
        quantize_static(
            prepared,
            out,
            _Reader(feeds),
            quant_format=QuantFormat.QDQ,
            op_types_to_quantize=["Conv", "MatMul", "Gemm"],
            per_channel=True,
            # Without VNNI, x86 adds two products in 16 bits, which overflow with 8-bit weights.
            reduce_range=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
        )
        return onnx.load(out)


@dataclass(frozen=True, slots=True)
class Reduced:
    """What was written.

    Attributes:
        files: the networks.
        card: in Markdown.
        figures: of both.
    """

    files: tuple[Path, ...]
    card: Path
    figures: Comparison


def reduce_network(
    network: Reducible,
    precision: Precision,
    judged_on: list[ImageSequence] | None = None,
    calibrated_on: list[ImageSequence] | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Reduced:
    """Reduce a network, measure it beside the original and write it with its card, or nothing.

    Args:
        network: which.
        precision: to which.
        judged_on: the sequences; None films the simulator's.
        calibrated_on: the same for INT8's scales.
        tell: is told what is being done.

    Raises:
        ModelError: it cannot be reduced, or its folder not be written.
        DatasetError: no target can be followed on these sequences.
        OSError: something cannot be read or written.
    """
    if not can_be_written(network.folder):
        raise ModelError(f"{network.folder}: cannot be written; reduced networks would go there")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        feeds: Mapping[str, list[Feeds]] = {}
        if precision is Precision.INT8:
            tell("calibrating")
            calibrated_on = calibrated_on or render_sequences(TO_CALIBRATE, folder / "calibration")
            feeds = inputs_of(network, calibrated_on)
        tell(f"reducing to {precision}")
        drafts = {path.name: folder / f"{path.stem}.{precision}.onnx" for path in network.files}
        for path in network.files:
            reduce_file(path, precision, feeds.get(path.name, []), drafts[path.name])
        tell("comparing")
        figures = compare(
            lambda: network.run(_by_name(network.files)),
            lambda: network.run(drafts.__getitem__),
            judged_on or render_sequences(TO_JUDGE, folder / "judgement"),
        )
        return _write(network, precision, list(drafts.values()), figures)


def _write(
    network: Reducible, precision: Precision, drafts: list[Path], figures: Comparison
) -> Reduced:
    network.folder.mkdir(parents=True, exist_ok=True)
    files = tuple(
        write_whole_bytes(network.folder / draft.name, draft.read_bytes()) for draft in drafts
    )
    rows = [
        (path.name, f"{path.stat().st_size} bytes, sha256 `{sha256_of(path)}`") for path in files
    ]
    before, after = figures.original, figures.reduced
    facts = [
        *rows,
        ("licence", network.licence),
        ("success, original and reduced", f"{before.success:.3f}, {after.success:.3f}"),
        ("AUC, original and reduced", f"{before.auc:.3f}, {after.auc:.3f}"),
        ("precision, original and reduced", f"{before.precision:.3f}, {after.precision:.3f}"),
        ("speed, reduced to original", f"{figures.speed:.2f}"),
        ("measured on", figures.on),
        ("taken by default", f"no: {figures.refusal}" if figures.refusal else "yes"),
    ]
    table = ["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in facts)]
    title = f"# {network.name}, {precision}"
    names = ", ".join(path.name for path in network.files)
    about = f"Made of {names} by `follower models quantise`."
    card = network.folder / f"{network.name}.{precision}.md"
    write_whole(card, "\n".join([title, "", about, "", *table, ""]))
    return Reduced(files, card, figures)
