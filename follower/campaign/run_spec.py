"""One run of a campaign, as plain values that can go to another machine."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from follower.sight import Sight
from follower.simulation_options import SimulationOptions

Value = float | int | str | bool
"""What a parameter of a campaign may be."""


@dataclass(frozen=True, slots=True)
class RunSpec:
    """One flight that a campaign is to make.

    Attributes:
        number: in the campaign, from 0.
        scenario: name or file.
        autopilot: "px4" or "ardupilot".
        seed: of everything random in it.
        sight: what vision goes by, by its name.
        overrides: settings of the follower, `key=value` each.
        scene: keys of the scenario likewise.
        values: the campaign's parameters by name, as drawn.
        config: a file of settings, None for none.
        contents: what tells the scenario's and the settings' text from others.
    """

    number: int
    scenario: str
    autopilot: str
    seed: int
    sight: str
    overrides: tuple[str, ...] = ()
    scene: tuple[str, ...] = ()
    values: dict[str, Value] = field(default_factory=dict)
    config: str | None = None
    contents: str = ""

    @property
    def key(self) -> str:
        """What tells this flight from others, whatever its number and campaign."""
        told = asdict(self)
        del told["number"], told["values"]
        text = json.dumps(told, sort_keys=True, ensure_ascii=True)
        return hashlib.sha256(text.encode("ascii")).hexdigest()[:16]

    @property
    def command(self) -> str:
        """The command line that flies it again, with report and video."""
        return self.options().command

    def options(self, **more: Any) -> SimulationOptions:
        """Return what `follower sim` is to be given."""
        return SimulationOptions(
            scenario=self.scenario,
            autopilot=self.autopilot,
            seed=self.seed,
            lockstep=True,
            config=None if self.config is None else Path(self.config),
            overrides=self.overrides,
            sight=Sight.of(self.sight),
            scene=self.scene,
            **more,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain values that JSON can hold."""
        return asdict(self)
