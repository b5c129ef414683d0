"""What `follower fly` and `follower preflight` were asked for, and what follows from it."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from follower.links.link_settings import LINK_KINDS
from follower.settings import Settings, settings_data
from follower.track_options import usual_detector
from follower_control.strict_yaml import SettingsError, parse
from follower_vision.box import Box
from follower_vision.connection import without_password
from follower_vision.trackers import is_tracker, tracker_names

_LENS_KEYS = ("fov_deg", "focal_px")


@dataclass(frozen=True, slots=True)
class FlyOptions:
    """What the command line was given; see `follower fly --help`.

    `look_s` is how long the checks look before they refuse.

    Raises:
        SettingsError: an option cannot be used.
    """

    connect: str
    camera: str
    target: Box | None = None
    select: str | None = None
    colour: str | None = None
    link: str | None = None
    tracker: str | None = None
    detector: str | None = None
    skip: tuple[str, ...] = ()
    config: Path | None = None
    overrides: tuple[str, ...] = ()
    out: Path = Path("runs")
    rate_hz: float = 30.0
    needs_target: bool = True
    look_s: float = 12.0
    cockpit: bool = False

    def __post_init__(self) -> None:
        if not self.camera.strip():
            raise SettingsError("which camera? give --camera 0, a video file or a stream's address")
        if self.link is not None and self.link not in LINK_KINDS:
            raise SettingsError(f"--link {self.link}: choose {' or '.join(LINK_KINDS)}")
        if self.tracker is not None and not is_tracker(self.tracker):
            names = ", ".join(tracker_names())
            raise SettingsError(f"--tracker {self.tracker}: no such tracker; there are {names}")
        if not 1 <= self.look_s <= 600:
            raise SettingsError(f"--seconds lies between 1 and 600, not {self.look_s:g}")
        ways = (self.target, self.select, self.colour)
        given = sum(way is not None for way in ways)
        if given > 1:
            raise SettingsError("choose by one of --target, --select and --colour alone")
        if self.needs_target and not given and not (self.cockpit or self.ground_station):
            raise SettingsError(
                "which target? give --select person, --colour '#rrggbb' or --target x,y,w,h, or "
                "--cockpit to choose it on a page, or --set ground_station.enabled=true for a "
                "ground station"
            )

    @property
    def ground_station(self) -> bool:
        """Whether the target can be chosen in a ground station."""
        section = self._data()[0].get("ground_station")
        return isinstance(section, dict) and section.get("enabled") is True

    @property
    def names_target(self) -> bool:
        """Whether the target is chosen before the flight."""
        return any(way is not None for way in (self.target, self.select, self.colour))

    @property
    def lens_given(self) -> bool:
        """Whether the user said anything about the lens."""
        return lens_given(self._data()[0])

    def settings(self) -> Settings:
        """Return the settings: file, then what the options stand for, then each `--set`.

        Raises:
            SettingsError: a file, key or value cannot be used.
        """
        data, source = self._data()
        settings = parse(Settings, data, source)
        if settings.detector is None and self.select is not None:
            return settings.model_copy(update={"detector": usual_detector()})
        return settings

    @property
    def wish(self) -> str:
        """What is to be followed, in words."""
        if self.select is not None:
            return self.select
        if self.colour is not None:
            return f"something of colour {self.colour}"
        if self.target is not None:
            return "the target"
        if self.ground_station and not self.cockpit:
            return "what the ground station points out"
        return "what the cockpit points out" if self.cockpit else "nothing"

    @property
    def shown_camera(self) -> str:
        """The camera without a password."""
        return without_password(self.camera)

    @property
    def command(self) -> str:
        """The command line that does this again."""
        words = ["follower", "fly", "--connect", self.connect, "--camera", self.shown_camera]
        box = None if self.target is None else ",".join(f"{v:g}" for v in self.target.xywh)
        for name, value in (
            ("target", box),
            ("select", self.select),
            ("colour", self.colour),
            ("link", self.link),
            ("tracker", self.tracker),
            ("detector", self.detector),
            ("config", self.config),
        ):
            words += [] if value is None else [f"--{name}", str(value)]
        words += ["--cockpit"] if self.cockpit else []
        for one in self.skip:
            words += ["--skip-preflight", one]
        for one in self.overrides:
            words += ["--set", one]
        return shlex.join(words)

    def _data(self) -> tuple[dict[str, Any], str]:
        return settings_data(self.config, None, (*self._implied(), *self.overrides))

    def _implied(self) -> Iterator[str]:
        for key, value in (
            ("tracker", self.tracker),
            ("detector", self.detector),
            ("link.kind", self.link),
        ):
            if value is not None:
                yield f"{key}={json.dumps(value)}"


def lens_given(data: dict[str, Any]) -> bool:
    """Whether settings, as they were written, describe the lens."""
    camera = data.get("camera")
    return isinstance(camera, dict) and any(camera.get(key) is not None for key in _LENS_KEYS)
