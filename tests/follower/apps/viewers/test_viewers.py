"""A flight as files for Foxglove, PlotJuggler and rerun: what is in them, and their layouts."""

from __future__ import annotations

import json
import math
import re
import resource
import subprocess
import sys
from collections.abc import Iterator
from functools import reduce
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from rich.console import Console

from follower.apps.inspect import inspect_flight, inspect_recorded
from follower.apps.viewers import scene
from follower.apps.viewers.foxglove_file import write_foxglove
from follower.apps.viewers.rerun_file import write_rerun
from follower.apps.viewers.scene import quaternion
from follower.recording import FlightFileError, RecordedFlight, open_flight
from follower.settings.settings import configs_folder
from follower.ui.terminal import console
from follower.ui.terminal.console import quiet_console
from follower_control.common.strict_config import SettingsError
from follower_vision.geometry.line_of_sight import rotation

pytestmark = pytest.mark.slow
CHASE = Path(__file__).parents[3] / "golden" / "chase"
VIEWERS = configs_folder() / "viewers"
SEEN_S = 14.0
ANGLES = st.floats(-math.pi, math.pi)


@pytest.fixture(scope="module")
def flight() -> RecordedFlight:
    return open_flight(CHASE)


@pytest.fixture(scope="module")
def exported(flight: RecordedFlight, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_foxglove(flight, tmp_path_factory.mktemp("viewers") / "chase.mcap")


def messages(path: Path, topic: str) -> Iterator[tuple[int, Any]]:
    """Give (nanoseconds, message) of a topic: JSON as it is, the rest by the file's own schema."""
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages([topic]):
            if channel.message_encoding == "json":
                yield message.log_time, json.loads(message.data)
                continue
            pool = descriptor_pool.DescriptorPool()
            for one in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                pool.Add(one)
            kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
            yield message.log_time, kind.FromString(message.data)


def at(path: Path, topic: str, flight: RecordedFlight, time_s: float = SEEN_S) -> Any:
    """Return the last message of a topic up to a time."""
    until = flight.config.epoch_ns + round(time_s * 1e9)
    return [message for time_ns, message in messages(path, topic) if time_ns <= until][-1]


def turned(turn: Any, vector: Any) -> np.ndarray:
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    u = np.array([x, y, z])
    v = np.asarray(vector, float)
    return 2 * u.dot(v) * u + (w * w - u.dot(u)) * v + 2 * w * np.cross(u, v)


@given(ANGLES, ANGLES, ANGLES)
def test_a_quaternion_turns_as_its_matrix(roll: float, pitch: float, yaw: float) -> None:
    matrix = rotation(roll, pitch, yaw)
    x, y, z, w = quaternion(matrix)
    assert math.hypot(x, y, z, w) == pytest.approx(1.0)
    turn = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    assert np.eye(3) + 2 * w * turn + 2 * turn @ turn == pytest.approx(matrix, abs=1e-9)


def test_the_file_has_the_logs_own_messages_to_the_bit(exported: Path) -> None:
    def own(path: Path) -> list[tuple[str, int, bytes]]:
        with path.open("rb") as file:
            found = make_reader(file).iter_messages(log_time_order=False)
            return sorted(
                (c.topic, m.log_time, m.data) for s, c, m in found if s.encoding[0] == "j"
            )

    assert own(exported) == own(CHASE / "flight.mcap")


def test_pictures_boxes_and_lens_are_those_of_the_flight(
    exported: Path, flight: RecordedFlight
) -> None:
    pictures = list(messages(exported, "/camera/image"))
    assert len(pictures) == sum(frame.video_index is not None for frame in flight.frames)
    image = cv2.imdecode(np.frombuffer(pictures[0][1].data, np.uint8), cv2.IMREAD_COLOR)
    assert image.shape == (flight.frames[0].height, flight.frames[0].width, 3)
    boxes = [message for _, message in messages(exported, "/camera/boxes")]
    tracks = [record.track for record in flight.log.tracks]
    assert [bool(one.points) for one in boxes] == [track is not None for track in tracks]
    corner, track = boxes[-1].points[0].points[0], tracks[-1]
    assert (corner.x, corner.y) == (track.box.left, track.box.top)
    lens = at(exported, "/camera/calibration", flight)
    assert list(lens.K) == flight.config.camera.matrix.ravel().tolist()


def test_the_target_in_the_scene_seen_through_the_camera_is_in_the_box(
    exported: Path, flight: RecordedFlight
) -> None:
    transforms = at(exported, "/tf", flight).transforms
    (camera,) = (one for one in transforms if one.child_frame_id == "camera")
    targets = [one for one in at(exported, "/scene", flight).entities if one.id == "target"]
    place = targets[0].spheres[0].pose.position
    seen = np.array([getattr(place, a) - getattr(camera.translation, a) for a in "xyz"])
    turn = camera.rotation
    turn.w = -turn.w  # the other way round: from the world to the camera
    ((x, y),) = flight.config.camera.pixels([turned(turn, seen)])
    drawn = at(exported, "/camera/boxes", flight).points[0].points
    assert drawn[0].x < x < drawn[2].x
    assert drawn[0].y < y < drawn[2].y
    ((_, paths),) = messages(exported, "/scene/paths")
    (path,) = (one for one in paths.entities if one.id == "true path")
    points = path.lines[0].points
    off_m = min(math.dist((place.x, place.y, place.z), (p.x, p.y, p.z)) for p in points)
    assert off_m < 2.0, "beside the target's true path"


def test_up_in_the_viewer_is_up(exported: Path, flight: RecordedFlight) -> None:
    (world,) = at(exported, "/tf_static", flight).transforms
    assert (world.parent_frame_id, world.child_frame_id) == ("world", "ned")
    north_east_down = turned(world.rotation, (1.0, 2.0, 3.0))
    assert north_east_down == pytest.approx((2.0, 1.0, -3.0)), "east, north, up"
    view = json.loads((VIEWERS / "foxglove.json").read_text("utf-8"))["configById"]["3D!world"]
    assert view["fixedFrame"] == "world"
    frames = {one.child_frame_id: one for one in at(exported, "/tf", flight).transforms}
    followed = frames[view["followTf"]]
    assert turned(followed.rotation, (0, 0, 1)) == pytest.approx((0, 0, -1)), "not upside down"
    assert followed.translation == frames["body"].translation


def test_what_is_written_once_is_not_hidden_by_later_messages(
    exported: Path, flight: RecordedFlight
) -> None:
    # A viewer that jumps to a time has each topic's newest message, and no older one.
    newest = [at(exported, topic, flight).transforms for topic in ("/tf_static", "/tf")]
    frames = {one.child_frame_id for transforms in newest for one in transforms}
    assert frames == {"ned", "vehicle", "body", "camera"}
    scenes = [at(exported, topic, flight).entities for topic in ("/scene/paths", "/scene")]
    things = {one.id for entities in scenes for one in entities}
    assert things == {"path", "true path", "target"}


def test_labels_are_as_large_on_every_size_of_picture(
    exported: Path, flight: RecordedFlight
) -> None:
    assert flight.frames[0].width == 320
    seen = at(exported, "/camera/boxes", flight)
    assert (seen.texts[0].font_size, seen.points[0].thickness) == (6.0, 1.0)


def test_a_flight_without_its_video_says_so_and_one_of_unknown_settings_is_refused(
    tmp_path: Path,
) -> None:
    (tmp_path / "bare").mkdir()
    for name in ("flight.mcap", "config.yaml"):
        (tmp_path / "bare" / name).write_bytes((CHASE / name).read_bytes())
    bare = open_flight(tmp_path / "bare")
    out = write_foxglove(bare, tmp_path / "bare.mcap")
    assert list(messages(out, "/camera/image")) == []
    assert len(list(messages(out, "/camera/boxes"))) == len(bare.log.tracks)
    assert "the flight has no video" in bare.remarks[-1]
    bare.config.settings["servo"]["distance_m"] = "far"
    with pytest.raises(FlightFileError, match=r"bare: its settings: .*distance_m"):
        write_foxglove(bare, out)


def field(topics: dict[str, list[Any]], topic: str, names: list[str]) -> set[type]:
    """Return the types of a field's values in a topic's messages; {} stands for a missing one."""
    found = [reduce(lambda part, name: part.get(name, {}), names, one) for one in topics[topic]]
    return {type(value) for value in found if value != {}}


def test_the_foxglove_layout_names_what_is_in_the_file(exported: Path) -> None:
    layout = json.loads((VIEWERS / "foxglove.json").read_text("utf-8"))
    panels = layout["configById"]
    placed = re.findall(r'"(\w+!\w+)"', json.dumps(layout["layout"]))
    assert sorted(placed) == sorted(panels)
    assert {name.partition("!")[0] for name in panels} == {
        "Image",
        "3D",
        "Plot",
        "StateTransitions",
    }
    with exported.open("rb") as file:
        summary = make_reader(file).get_summary()
    topics = {one.topic: summary.schemas[one.schema_id].name for one in summary.channels.values()}
    mode = panels["Image!camera"]["imageMode"]
    assert topics[mode["imageTopic"]] == "foxglove.CompressedImage"
    assert topics[mode["calibrationTopic"]] == "foxglove.CameraCalibration"
    assert {topics[name] for name in mode["annotations"]} == {"foxglove.ImageAnnotations"}
    assert topics["/tf"] == "foxglove.FrameTransforms"
    assert set(panels["3D!world"]["topics"]) <= set(topics)
    assert {name for name, kind in topics.items() if kind.endswith("SceneUpdate")} <= set(
        panels["3D!world"]["topics"]
    )
    for name, panel in panels.items():
        assert panel["foxglovePanelTitle"] == panel["lichtblickPanelTitle"]
        for path in panel.get("paths", ()):
            topic, *names = path["value"].split(".")
            logged = {topic: [message for _, message in messages(exported, topic)]}
            wanted = {str} if name.startswith("State") else {int, float}
            assert field(logged, topic, names), path
            assert field(logged, topic, names) <= wanted, path


def test_the_plotjuggler_layout_names_curves_of_the_log() -> None:
    root = ElementTree.parse(VIEWERS / "plotjuggler.xml").getroot()
    curves = [element.attrib["name"] for element in root.iter("curve")]
    assert len(curves) >= 8
    log = CHASE / "flight.mcap"
    for curve in curves:
        topic = "/".join(curve.split("/")[:3])
        logged = {topic: [message for _, message in messages(log, topic)]}
        assert field(logged, topic, curve.split("/")[3:]) <= {int, float}, curve
        assert field(logged, topic, curve.split("/")[3:]), curve


def rerun(*arguments: str) -> str:
    ran = subprocess.run(
        [sys.executable, "-m", "rerun_cli", *arguments],
        capture_output=True,
        text=True,
        timeout=200,
        check=True,
    )
    return ran.stdout


def test_rerun_reads_both_files_back(
    flight: RecordedFlight, exported: Path, tmp_path: Path
) -> None:
    own = write_rerun(flight, tmp_path / "chase.rrd")
    rerun("rrd", "verify", str(own))
    counted = rerun("rrd", "stats", str(own))
    for entity in ("world/camera/image/target", "world/target", "plots/velocity/forward_asked"):
        assert f"/{entity}: " in counted
    rerun("mcap", "convert", str(exported), "-o", str(tmp_path / "foxglove.rrd"))
    counted = rerun("rrd", "stats", str(tmp_path / "foxglove.rrd"))
    for topic in ("/camera/image", "/camera/boxes", "/scene", "/tf", "/vehicle/fix"):
        assert f"{topic}: " in counted


def test_inspect_writes_them_beside_the_report(tmp_path: Path) -> None:
    files = {"foxglove": tmp_path / "new" / "a.mcap", "rerun": tmp_path / "new" / "a.rrd"}
    with (tmp_path / "said").open("w") as said:
        inspect_flight(CHASE, tmp_path / "r.html", Console(file=said, width=300), **files)
    lines = (tmp_path / "said").read_text().splitlines()
    assert [line.strip() for line in lines[-2:]] == [str(path) for path in files.values()]
    assert all(path.stat().st_size > 100_000 for path in files.values())


@pytest.mark.parametrize("write", [write_foxglove, write_rerun])
def test_a_place_that_cannot_be_written_is_an_error_of_the_system(
    write: Any, flight: RecordedFlight, tmp_path: Path
) -> None:
    with pytest.raises(OSError, match=re.escape(str(tmp_path))):
        write(flight, tmp_path)
    own = flight.folder / "flight.mcap"
    before = own.read_bytes()
    for writes in (write, inspect_recorded):
        with pytest.raises(OSError, match="belongs to the recording"):
            writes(flight, own)
    assert own.read_bytes() == before


@pytest.mark.parametrize("write", [write_foxglove, write_rerun])
def test_a_file_for_which_there_is_no_room_is_an_error_and_nothing_of_it_is_left(
    write: Any, flight: RecordedFlight, tmp_path: Path
) -> None:
    out, before = tmp_path / "out", resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, before[1]))
    try:
        with pytest.raises(OSError, match=re.escape(str(out))):
            write(flight, out)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not out.exists()


@pytest.mark.parametrize("name", ["foxglove", "rerun"])
def test_without_its_package_one_line_says_how_to_get_it(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(console, "find_spec", lambda _: None)
    with pytest.raises(SettingsError, match=rf"--{name} needs {name}; .*\[{name}\]"):
        inspect_flight(CHASE, tmp_path / "r", quiet_console(), **{name: tmp_path / "out"})
    assert list(tmp_path.iterdir()) == []


def test_both_files_use_the_colours_of_every_state() -> None:
    assert set(scene.COLOURS) == {"tracking", "coasting", "lost"}
