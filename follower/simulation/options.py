"""What the command line asks of a simulated flight, and what becomes of it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from follower.settings.link import check_link
from follower.settings.settings import Settings, find_scenario, load_settings
from follower.simulation.sitl.programs import SitlProgram, SitlSetup
from follower_control.common.strict_config import SettingsError
from follower_sim.scenario.scenario import Scenario
from follower_sim.scenario.scenario_file import SCENE, base_settings, load_scenario

EXTERNAL = "external"
"""An autopilot that is no object of ours."""


class VisionSource(StrEnum):
    """What vision goes by in a simulated flight."""

    PIXELS = "pixels"
    """Trackers work on rendered images."""
    TRUTH = "truth+noise"
    """A `NoisyTracker` reports the true box with noise; nothing uses a pixel."""

    @classmethod
    def of(cls, text: str) -> VisionSource:
        """Return the one of this name.

        Raises:
            SettingsError: there is none.
        """
        try:
            return cls(text)
        except ValueError:
            raise SettingsError(f"--vision {text}: choose {' or '.join(cls)}") from None


def check_without_pixels(scenario: Scenario, faults: Sequence[str] = ()) -> None:
    """Refuse what is not there without pixels.

    Raises:
        SettingsError: a fault was asked for: they are flown with pixels only.
    """
    kinds = {fault.kind for fault in scenario.faults} & {"black", "frozen"}
    if kinds or faults:
        named = f"--fault {faults[0]}" if faults else f"the scenario's fault {sorted(kinds)[0]!r}"
        raise SettingsError(
            f"--vision {VisionSource.TRUTH}: {named} needs a flight with pixels; leave --vision out"
        )


def simulation_settings(
    scenario: Scenario,
    config: Path | None = None,
    overrides: Sequence[str] = (),
    link: str | None = None,
) -> Settings:
    """Resolve the settings: the scenario's camera and requests first, the user's on top.

    Args:
        scenario: what is flown.
        config: a file of settings.
        overrides: `key=value` each.
        link: which library speaks MAVLink, None as the settings say.

    Raises:
        SettingsError: one of them cannot be used.
    """
    check_link(link)
    kind = () if link is None else (f"link.kind={link}",)
    return load_settings(config, base_settings(scenario), (*overrides, *kind))


@dataclass(frozen=True, slots=True)
class SimulationOptions:
    """What the command line was given; see `follower sim --help`."""

    scenario: str
    autopilot: str = "px4"
    seed: int | None = None
    lockstep: bool = False
    config: Path | None = None
    overrides: tuple[str, ...] = ()
    out: Path = Path("runs")
    video: bool = True
    connect: str | None = None
    record: bool = True
    link: str | None = None
    faults: tuple[str, ...] = ()
    vision: VisionSource = VisionSource.PIXELS
    scene: tuple[str, ...] = ()
    cockpit: bool = False
    program: SitlProgram | None = None
    """Is started for the flight and flown as the external autopilot."""
    setup: SitlSetup = field(default_factory=SitlSetup)

    def resolve(self) -> tuple[Scenario, Settings]:
        """Return what is flown, and the follower's settings for it.

        Raises:
            SettingsError: the scenario or a setting cannot be used, or one needs the other.
        """
        if self.seed is not None and self.seed < 0:
            raise SettingsError(f"--seed {self.seed}: a seed is 0 or more")
        scenario = load_scenario(find_scenario(self.scenario), self.scene)
        if self.vision is VisionSource.TRUTH:
            check_without_pixels(scenario, self.faults)
        settings = simulation_settings(scenario, self.config, self.overrides, self.link)
        if self.autopilot == EXTERNAL and scenario.camera.gimbal is not None:
            raise SettingsError(
                f"the scenario {scenario.name} needs a gimbal, and no external autopilot here has "
                "one that our camera follows: fly it with --autopilot px4 or ardupilot"
            )
        if self.lockstep and settings.link.kind == "mavsdk":
            raise SettingsError(
                "--lockstep: mavsdk has its own threads and time; use --link pymavlink"
            )
        if self.setup.speedup != 1.0 and settings.link.kind == "mavsdk":
            raise SettingsError("--speedup: mavsdk has its own time; use --link pymavlink")
        return scenario, settings

    @property
    def recorded(self) -> bool:
        """Whether it is recorded; a replay could see nothing in a recording without pixels."""
        return self.record and self.vision is VisionSource.PIXELS

    @property
    def command(self) -> str:
        """The command line that does this run again."""
        words = ["follower", "sim", self.scenario, "--autopilot", self.autopilot]
        if self.program is not None:
            words = ["follower", "sitl", self.scenario, *self.program.words]
            words += [] if self.setup.speedup == 1.0 else ["--speedup", f"{self.setup.speedup:g}"]
            words += [] if self.setup.file is None else ["--params", str(self.setup.file)]
        words += [] if self.connect is None else ["--connect", self.connect]
        words += [] if self.link is None else ["--link", self.link]
        words += [] if self.seed is None else ["--seed", str(self.seed)]
        words += ["--lockstep"] if self.lockstep else []
        words += ["--cockpit"] if self.cockpit else []
        words += [] if self.config is None else ["--config", str(self.config)]
        for override in self.overrides:
            words += ["--set", override]
        for override in self.scene:
            words += [SCENE, override]
        words += [] if self.vision is VisionSource.PIXELS else ["--vision", self.vision]
        for fault in self.faults:
            words += ["--fault", fault]
        return shlex.join(words)
