"""A recorded flight for rerun.io: pictures, boxes, a scene, plots and events, with their layout."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from follower.apps.viewers.scene import COLOURS, FlightScene, Pose, emptied
from follower.flight.log import TrackRecord
from follower.recording import RecordedFlight
from follower.recording.recorded_flight import Table

_CAMERA, _IMAGE, _BOX = "world/camera", "world/camera/image", "world/camera/image/target"
_TIME = "flight"
_VELOCITIES = tuple(
    (kind, axis) for axis in ("forward", "right", "down") for kind in ("asked", "allowed")
)
_PLOTS = (
    *((f"velocity/{axis}_{kind}", "controls", f"{kind}_{axis}_m_s") for kind, axis in _VELOCITIES),
    ("yaw_rate/asked", "controls", "asked_yaw_rate_rad_s"),
    ("yaw_rate/allowed", "controls", "allowed_yaw_rate_rad_s"),
    ("confidence/track", "tracks", "confidence"),
)
"""Path below "plots", table and column of `RecordedFlight.arrays`."""


def write_rerun(recorded: RecordedFlight, out: Path) -> Path:
    """Write the file, over one that is there, and return its path.

    Raises:
        FlightFileError: the flight's settings are not understood.
        OSError: the file cannot be written.
    """
    scene = FlightScene(recorded)
    stream = rr.RecordingStream("drone-target-follower", send_properties=False)
    with emptied(out, recorded):
        stream.save(out, default_blueprint=_layout())
        _write_all(stream, recorded, scene)
        stream.flush()  # raises what the thread that writes ran into
        stream.disconnect()
    return out


def _write_all(stream: rr.RecordingStream, recorded: RecordedFlight, scene: FlightScene) -> None:
    stream.set_log_time_enabled(False)  # when this was written is of no interest
    stream.set_log_tick_enabled(False)
    stream.log("world", rr.ViewCoordinates.FRD, static=True)
    _write_still(stream, scene)
    _write_pictures(stream, scene)
    for track in recorded.log.tracks:
        _write_box(stream, track)
    for record in recorded.log.controls[::2]:
        stream.set_time(_TIME, duration=record.time_s)
        for name, pose in (("world/body", scene.body(record)), (_CAMERA, scene.eye(record))):
            if pose is not None:
                stream.log(name, _transform(pose))
        place, body = scene.target(record), scene.body(record)
        sights = [] if place is None or body is None else [[body.position_m, place]]
        stream.log("world/target", rr.Points3D([sight[1] for sight in sights], radii=0.5))
        stream.log("world/line_of_sight", rr.LineStrips3D(sights))
    tables = recorded.arrays()
    for path, table, column in _PLOTS:
        _write_plot(stream, f"plots/{path}", tables[table], column)
    _write_events(stream, recorded)


def _layout() -> rrb.Blueprint:
    views = ("velocity", "yaw_rate", "confidence")
    plots = [rrb.TimeSeriesView(origin=f"plots/{name}", name=name) for name in views]
    picture = rrb.Spatial2DView(origin=_IMAGE, name="Camera")
    world = rrb.Spatial3DView(origin="world", name="World, north east down")
    events = rrb.TextLogView(origin="events", name="Events")
    above = rrb.Horizontal(picture, world)
    below = rrb.Horizontal(rrb.Vertical(*plots), events, column_shares=[2, 1])
    return rrb.Blueprint(rrb.Vertical(above, below), collapse_panels=True)


def _write_still(stream: rr.RecordingStream, scene: FlightScene) -> None:
    for name, points in (("path", scene.path()), ("true_path", scene.true_path())):
        if points:
            stream.log(f"world/{name}", rr.LineStrips3D([points]), static=True)
    lens = scene.camera
    if lens is not None:
        size = [lens.width, lens.height]
        pinhole = rr.Pinhole(
            image_from_camera=lens.matrix, resolution=size, camera_xyz=rr.ViewCoordinates.RDF
        )
        stream.log(_IMAGE, pinhole, static=True)


def _write_pictures(stream: rr.RecordingStream, scene: FlightScene) -> None:
    for captured_s, data in scene.pictures():
        stream.set_time(_TIME, duration=captured_s)
        stream.log(_IMAGE, rr.EncodedImage(contents=data, media_type="image/jpeg"))


def _write_box(stream: rr.RecordingStream, record: TrackRecord) -> None:
    stream.set_time(_TIME, duration=record.captured_s)
    track = record.track
    if track is None:
        stream.log(_BOX, rr.Boxes2D(centers=[], sizes=[]))
        return
    box, label = track.box, f"{track.state} {track.confidence:.2f} {track.produced_by}"
    centre, size = [[box.cx, box.cy]], [[box.width, box.height]]
    colour = [COLOURS[track.state]]
    stream.log(_BOX, rr.Boxes2D(centers=centre, sizes=size, colors=colour, labels=[label]))


def _write_plot(stream: rr.RecordingStream, path: str, table: Table, column: str) -> None:
    times = table["time_s" if "time_s" in (table.dtype.names or ()) else "done_s"]
    known = np.isfinite(table[column])
    index = rr.TimeColumn(_TIME, duration=times[known])
    stream.send_columns(path, [index], rr.Scalars.columns(scalars=table[column][known]))


def _write_events(stream: rr.RecordingStream, recorded: RecordedFlight) -> None:
    for event in recorded.log.events:
        stream.set_time(_TIME, duration=event.time_s)
        stream.log("events", rr.TextLog(f"{event.source}: {event.text}"))


def _transform(pose: Pose) -> rr.Transform3D:
    return rr.Transform3D(
        translation=list(pose.position_m), quaternion=rr.Quaternion(xyzw=list(pose.turn))
    )
