"""Writes a replay as a flight of its own: a reference for later replays of the same pictures."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from follower.flightlog import (
    ControlRecord,
    Event,
    Observation,
    Selection,
    TrackRecord,
)
from follower.recorder import FlightConfig, RecordedFlight
from follower.recorder.log_writer import LOG, TLOG, control_messages
from follower.recorder.mcap_log import McapLog
from follower.recorder.recorder import CONFIG
from follower.recorder.records import FrameRecord
from follower.recorder.video_queue import VIDEO
from follower.settings import Settings
from follower_sim.truth_sample import TruthSample
from follower_vision.frame import Frame
from follower_vision.framesource import ClosesItself

_COMMIT_EVERY = 2000
_KEPT = (FrameRecord, Selection, TruthSample)


class ReplaySaver(ClosesItself):
    """Takes the replay's log as it grows and writes a flight folder, whose video is the old one.

    Args:
        flight: what is replayed.
        folder: exists and is empty.
        settings: of the replay.
        overrides: what is other in them than in the flight's, as on the command line. Such a replay
            is labelled open loop.

    Raises:
        OSError: it cannot be written.
    """

    def __init__(
        self,
        flight: RecordedFlight,
        folder: Path,
        settings: Settings,
        overrides: Sequence[str] = (),
    ) -> None:
        label = {"open_loop": f"replayed with {', '.join(overrides)}"} if overrides else {}
        run = {**label, **flight.config.run, "tracks_from": "the recorded video, decoded"}
        now = FlightConfig.of(flight.config.kind, settings)
        config = replace(
            flight.config,
            settings=now.settings,
            versions=now.versions,
            models=now.models,
            run=run,
        )
        (folder / CONFIG).write_text(config.to_yaml(), "utf-8")
        self._log = McapLog(folder / LOG, config.epoch_ns, config.to_yaml())
        self._waiting = 0
        for name in (TLOG, VIDEO):
            _link(flight.folder / name, folder / name)

    def __call__(self, time_s: float, message: object) -> None:
        """Copy a recorded message that the replay does not make anew."""
        own_event = isinstance(message, Event) and message.source != "supervisor"
        if isinstance(message, _KEPT) or own_event:
            self._write(message, time_s)

    def close(self) -> None:
        """Finish the log."""
        self._log.close()

    def add_frame(self, frame: Frame, received_s: float) -> None:
        """Do nothing: the recorded frame was copied."""

    def add_selection(self, selection: Selection, received_s: float) -> None:
        """Do nothing: the recorded selection was copied."""

    def add_track(self, record: TrackRecord) -> None:
        """Write the replay's answer."""
        self._write(record, record.done_s)

    def add_observation(self, observation: Observation) -> None:
        """Write what control made of it."""
        self._write(observation, observation.time_s)

    def add_control(self, record: ControlRecord) -> None:
        """Write the replay's step."""
        for part in control_messages(record):
            self._write(part, record.time_s)

    def add_event(self, event: Event) -> None:
        """Write what the supervisor said."""
        self._write(event, event.time_s)

    def _write(self, message: object, time_s: float) -> None:
        self._log.write(message, time_s)
        self._waiting += 1
        if self._waiting >= _COMMIT_EVERY:
            self._waiting = 0
            self._log.commit()


def _link(source: Path, target: Path) -> None:
    """Give a file a second name, or copy it where the disks differ; nothing if there is none."""
    try:
        os.link(source, target)
    except FileNotFoundError:
        return
    except OSError:
        shutil.copyfile(source, target)
