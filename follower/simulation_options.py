"""What a simulated flight is asked to be."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

from follower.sight import Sight
from follower_sim.scenario_file import SCENE


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
    connect: str = "udpin:127.0.0.1:14540"
    record: bool = True
    link: str | None = None
    faults: tuple[str, ...] = ()
    sight: Sight = Sight.PIXELS
    scene: tuple[str, ...] = ()
    cockpit: bool = False

    @property
    def recorded(self) -> bool:
        """Whether it is recorded; a replay could see nothing in a recording without pixels."""
        return self.record and self.sight is Sight.PIXELS

    @property
    def command(self) -> str:
        """The command line that does this run again."""
        words = ["follower", "sim", self.scenario, "--autopilot", self.autopilot]
        words += [] if self.lockstep else ["--connect", self.connect]
        words += [] if self.link is None else ["--link", self.link]
        words += [] if self.seed is None else ["--seed", str(self.seed)]
        words += ["--lockstep"] if self.lockstep else []
        words += ["--cockpit"] if self.cockpit else []
        words += [] if self.config is None else ["--config", str(self.config)]
        for override in self.overrides:
            words += ["--set", override]
        for override in self.scene:
            words += [SCENE, override]
        words += [] if self.sight is Sight.PIXELS else ["--vision", self.sight]
        for fault in self.faults:
            words += ["--fault", fault]
        return shlex.join(words)
