"""What `follower import` was asked for."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass
from pathlib import Path

from follower.settings import Settings
from follower.track_options import LIST, TrackOptions
from follower_control.strict_yaml import SettingsError
from follower_vision.box import Box
from follower_vision.sources import is_live


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """What the command line was given; see `follower import --help`.

    Raises:
        SettingsError: the options do not say which target, or contradict each other.
    """

    source: str
    telemetry: Path | None = None
    target: Box | None = None
    select: str | None = None
    colour: str | None = None
    at_s: float = 0.0
    offset_s: float | None = None
    fov_deg: float | None = None
    tracker: str | None = None
    detector: str | None = None
    config: Path | None = None
    overrides: tuple[str, ...] = ()
    out: Path = Path("runs")
    rate_hz: float = 30.0

    def __post_init__(self) -> None:
        if is_live(self.source):
            raise SettingsError(f"{self.source}: import takes a recording; live: `follower track`")
        if self.select == LIST:
            raise SettingsError("`follower track VIDEO --select list` lists what there is")
        if not (math.isfinite(self.at_s) and self.at_s >= 0):
            raise SettingsError(f"--at {self.at_s}: seconds from the video's beginning, from 0 on")
        if self.offset_s is not None and self.telemetry is None:
            raise SettingsError("--offset needs --telemetry: it is the time between the two")
        if self.offset_s is not None and not math.isfinite(self.offset_s):
            raise SettingsError(f"--offset {self.offset_s}: a finite number of seconds")
        self._track_options()

    def settings(self) -> Settings:
        """Return the settings: file, then what the options stand for, then each `--set`.

        Raises:
            SettingsError: a file, key or value cannot be used.
        """
        return self._track_options().settings()

    @property
    def wish(self) -> str:
        """The target in words."""
        if self.select is not None:
            return self.select
        if self.target is not None:
            return f"the box {_xywh(self.target)}"
        return f"something of colour {self.colour}"

    @property
    def command(self) -> str:
        """The command line that does this again."""
        pairs = (
            ("--telemetry", self.telemetry),
            ("--offset", self.offset_s),
            ("--target", None if self.target is None else _xywh(self.target)),
            ("--select", self.select),
            ("--colour", self.colour),
            ("--at", self.at_s or None),
            ("--fov", self.fov_deg),
            ("--tracker", self.tracker),
            ("--detector", self.detector),
            ("--config", self.config),
            *(("--set", text) for text in self.overrides),
        )
        words = [str(word) for pair in pairs if pair[1] is not None for word in pair]
        return shlex.join(["follower", "import", self.source, *words])

    def _track_options(self) -> TrackOptions:
        """Choosing a target and its tracker is the same as for `follower track`."""
        fov = () if self.fov_deg is None else (f"camera.fov_deg={self.fov_deg}",)
        return TrackOptions(
            self.source,
            targets=() if self.target is None else (self.target,),
            select=() if self.select is None else (self.select,),
            colour=self.colour,
            tracker=self.tracker,
            detector=self.detector,
            config=self.config,
            overrides=(*fov, *self.overrides),
            rate_hz=self.rate_hz,
        )


def _xywh(box: Box) -> str:
    return ",".join(f"{value:g}" for value in box.xywh)
