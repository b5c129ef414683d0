"""What a campaign's YAML file may say."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from follower.settings.settings import configs_folder, find_scenario
from follower.simulation.campaign.metrics import RunMetrics
from follower.simulation.options import SimulationOptions, VisionSource
from follower_control.common.strict_config import SettingsError, parse, read_mapping

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
        vision: what vision goes by, by its name.
        overrides: settings of the follower, `key=value` each.
        scene: keys of the scenario likewise.
        values: the campaign's parameters by name, as drawn.
        config: a file of settings, None for none.
        contents: a digest of the scenario's and the settings' text.
    """

    number: int
    scenario: str
    autopilot: str
    seed: int
    vision: str
    overrides: tuple[str, ...] = ()
    scene: tuple[str, ...] = ()
    values: dict[str, Value] = field(default_factory=dict)
    config: str | None = None
    contents: str = ""

    @property
    def key(self) -> str:
        """A digest of what is flown, whatever its number and campaign."""
        flown = asdict(self)
        del flown["number"], flown["values"]
        flown["sight"] = flown.pop("vision")  # its name in what was flown before
        text = json.dumps(flown, sort_keys=True, ensure_ascii=True)
        return hashlib.sha256(text.encode("ascii")).hexdigest()[:16]

    def options(self, **more: Any) -> SimulationOptions:
        """Return what `follower sim` is to be given."""
        return SimulationOptions(
            scenario=self.scenario,
            autopilot=self.autopilot,
            seed=self.seed,
            lockstep=True,
            config=None if self.config is None else Path(self.config),
            overrides=self.overrides,
            vision=VisionSource.of(self.vision),
            scene=self.scene,
            **more,
        )


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


_NotNegative = Annotated[float, Field(ge=0)]
_Share = Annotated[float, Field(ge=0, le=1)]


class Goals(_Section):
    """Limits for each run, and for the share of occlusions of the whole campaign.

    Attributes:
        min_in_frame_share: least share of the time with the target in frame, occlusions left out.
        max_line_of_sight_rms_deg: largest root mean square of the line-of-sight error of the true
            box's middle, occlusions left out, what follows them included.
        occlusion_s: occlusions up to this length have to be got over ...
        reacquired_s: ... within this time of their end, ...
        reacquired_share: ... this share of all of them.
        max_violations: most violations of the envelope in a run.
        keep_out: whether a run fails that came nearer to the target than the keep-out.
    """

    min_in_frame_share: _Share = 0.99
    max_line_of_sight_rms_deg: _NotNegative = 3.0
    occlusion_s: _NotNegative = 3.0
    reacquired_s: _NotNegative = 1.0
    reacquired_share: _Share = 0.98
    max_violations: Annotated[int, Field(ge=0)] = 0
    keep_out: bool = True

    def failures(self, figures: RunMetrics) -> list[str]:
        """Return which goals a run missed, by the figures' names, and how it lost its target."""
        if figures.time_to_acquire_s is None:
            return ["never followed"]
        if figures.approach_s is None:
            return ["never approached"]
        share, angle = figures.in_frame_share, figures.line_of_sight_box_rms_seen_deg
        found = {
            "in frame": share is None or share < self.min_in_frame_share,
            "line of sight": angle is None or angle > self.max_line_of_sight_rms_deg,
            "re-acquisition": self.late(figures) > 0,
            "envelope": figures.envelope_violations > self.max_violations,
            "keep-out": self.keep_out and figures.is_too_near,
        }
        missed = [name for name, failed in found.items() if failed]
        return missed if figures.wrong_end is None else [*missed, figures.wrong_end]

    def short(self, figures: RunMetrics) -> list[float | None]:
        """Return the times to re-acquisition, s, after the occlusions that count; None: never."""
        pairs = zip(figures.occlusion_s, figures.reacquired_s, strict=True)
        return [took for length, took in pairs if length <= self.occlusion_s]

    def late(self, figures: RunMetrics) -> int:
        """Return after how many of them the target was not seen in time."""
        return sum(took is None or took > self.reacquired_s for took in self.short(figures))


SCENE = "scene."
"""What a key of the scenario begins with; the others are settings of the follower."""


_OWN_SEEDS = (
    "runs have seeds of their own, not the scenario's: the same flights would count twice; say how"
    " many `runs` or `repeats`"
)


class CampaignParameter(_Section):
    """Something that differs from run to run: a key, and what it may be."""

    key: str | None = None
    """A setting such as `servo.azimuth.kp`, or one of the scenario such as
    `scene.wind.mean_m_s`."""
    keys: dict[str, float] = Field(default_factory=dict)
    """In place of `key`: several keys, each with the factor by which it takes the number."""
    values: list[Value] | None = None
    """One of these."""
    between: tuple[float, float] | None = None
    """In place of `values`: any number from the first to the second, equally likely."""

    @model_validator(mode="after")
    def _one_of_each(self) -> Self:
        if (self.key is None) == (not self.keys):
            raise ValueError("a parameter has either `key` or `keys`")
        if (self.values is None) == (self.between is None):
            raise ValueError("a parameter has either `values` or `between`")
        if self.values is not None:
            self._check_values(self.values)
        elif self.between is not None and not 0 < self.between[1] - self.between[0] < math.inf:
            raise ValueError("a parameter lies `between` a smaller and a larger number")
        if f"{SCENE}seed" in self.key_names:
            raise ValueError(_OWN_SEEDS)
        return self

    @property
    def key_names(self) -> tuple[str, ...]:
        """What is set by it."""
        return tuple(self.keys) if self.key is None else (self.key,)

    def _check_values(self, values: Sequence[Value]) -> None:
        if not values:
            raise ValueError("a parameter's `values` are at least one")
        if min(len({str(value) for value in values}), len(set(values))) < len(values):
            raise ValueError("a parameter's `values` differ: the same flights would count twice")
        if self.keys and not all(type(value) in (int, float) for value in values):
            raise ValueError("with `keys`, which take them times their factors, values are numbers")

    def assignments(self, value: Value) -> list[tuple[str, Value]]:
        """Return each key with the value that it takes."""
        if self.key is not None:
            return [(self.key, value)]
        return [(key, significant(factor * float(value))) for key, factor in self.keys.items()]


class OptimiseSettings(_Section):
    """A search for settings with a smaller cost."""

    trials: Annotated[int, Field(ge=1)] = 40
    runs_per_trial: Annotated[int, Field(ge=1)] = 24
    """Each trial flies the same runs, the campaign's first ones."""
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    settings: dict[str, tuple[float, float]] = Field(min_length=1)
    """Which settings of the follower, each from the smallest to the largest value tried."""


class CampaignConfig(_Section):
    """Many flights: scenarios times parameters times seeds."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9-]+$")]
    title: str
    scenarios: list[str] = Field(min_length=1)
    autopilots: list[Literal["px4", "ardupilot"]] = Field(default=["px4"], min_length=1)
    runs: Annotated[int, Field(ge=1)] | None = None
    """How many are drawn at random; without it, every combination is flown, `repeats` times."""
    repeats: Annotated[int, Field(ge=1)] = 1
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 1
    vision: VisionSource = VisionSource.PIXELS
    config: Path | None = None
    """A file of settings, such as `follower tune` writes; beside the campaign's file."""
    set: list[str] = Field(default_factory=list)
    """Settings that all runs have, `key=value` each."""
    scene: list[str] = Field(default_factory=list)
    """Keys of the scenarios likewise."""
    parameters: dict[str, CampaignParameter] = Field(default_factory=dict)
    goals: Goals = Goals()
    optimise: OptimiseSettings | None = None

    def to_yaml(self) -> str:
        """Return the campaign as resolved."""
        return yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False)

    @field_validator("scenarios")
    @classmethod
    def _exist(cls, names: list[str]) -> list[str]:
        for name in names:
            if not find_scenario(name).exists():
                raise ValueError(f"{name}: there is no such file")
        return names

    @model_validator(mode="after")
    def _differ(self) -> Self:
        if any(text.partition("=")[0] == "seed" for text in self.scene):
            raise ValueError(_OWN_SEEDS)
        for name, named in (("scenarios", self.scenarios), ("autopilots", self.autopilots)):
            if self.runs is None and len(set(named)) < len(named):
                raise ValueError(f"{name} differ where every combination is flown: the same flights"
                                 " would count twice")  # fmt: skip
        return self

    @model_validator(mode="after")
    def _can_be_combined(self) -> Self:
        taken: dict[str, str] = {}
        for name, parameter in self.parameters.items():
            for key in parameter.key_names:
                if key in taken:
                    raise ValueError(f"parameters {taken[key]!r} and {name!r} both set {key}")
                taken[key] = name
            if self.runs is None and parameter.values is None:
                raise ValueError(f"parameter {name!r}: every combination needs `values`; or say"
                                 " how many `runs` to draw")  # fmt: skip
        return self


def campaign_files() -> dict[str, Path]:
    """Return the campaigns that come with the project, by name."""
    return {path.stem: path for path in sorted((configs_folder() / "campaigns").glob("*.yaml"))}


def load_campaign(text: str, **changes: Any) -> CampaignConfig:
    """Read a campaign given by its file or by the name of one that comes along.

    Args:
        text: file or name.
        changes: other values for keys at the top; None leaves one as it is.

    Raises:
        SettingsError: there is none, or it cannot be used; one line says which key and why.
    """
    path = Path(text)
    if path.suffix not in (".yaml", ".yml") and not path.is_file():
        known = campaign_files()
        if text not in known:
            raise SettingsError(
                f"there is no campaign {text!r}: give a YAML file, or one of {', '.join(known)}"
            )
        path = known[text]
    data = read_mapping(path) | {key: one for key, one in changes.items() if one is not None}
    return parse(CampaignConfig, _resolved(data, path.parent), str(path))


def _resolved(data: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Let a file of settings and files of scenarios be found from the campaign's folder."""
    result = dict(data)
    if isinstance(result.get("config"), str):
        result["config"] = str(folder / result["config"])
    if isinstance(result.get("scenarios"), list):
        result["scenarios"] = [
            str(folder / one) if str(one).endswith((".yaml", ".yml")) else one
            for one in result["scenarios"]
        ]
    return result


def significant(value: float) -> float:
    """Round to four digits, so that command lines stay short."""
    return float(f"{value:.4g}")


_LARGEST_SEED = 1_000_000
_MOST_RUNS = 1_000_000


def planned(config: CampaignConfig) -> list[RunSpec]:
    """Return the campaign's runs. The first ones are the same however many are drawn.

    Raises:
        SettingsError: there are too many, or a file of theirs cannot be read.
    """
    count = _count(config)
    if count > _MOST_RUNS:
        raise SettingsError(f"these are {count:,} runs; a campaign has at most {_MOST_RUNS:,}")
    contents = {one: contents_of(one, config.config) for one in config.scenarios}
    specs = _combined(config) if config.runs is None else _drawn(config, config.runs)
    return [replace(spec, contents=contents[spec.scenario]) for spec in specs]


def _count(config: CampaignConfig) -> int:
    if config.runs is not None:
        return config.runs
    choices = (len(one.values or []) for one in config.parameters.values())
    kinds = len(config.scenarios) * len(config.autopilots)
    return kinds * math.prod(choices) * config.repeats


def contents_of(scenario: str, config: Path | str | None) -> str:
    """Return a digest of a scenario's and the settings' text: changed, they fly otherwise.

    Raises:
        SettingsError: a file cannot be read.
    """
    digest = hashlib.sha256()
    for path in (find_scenario(scenario), config):
        try:
            digest.update(b"" if path is None else hashlib.sha256(Path(path).read_bytes()).digest())
        except OSError as error:
            raise SettingsError(f"{path}: it cannot be read: {error.strerror}") from error
    return digest.hexdigest()[:16]


def _combined(config: CampaignConfig) -> Iterator[RunSpec]:
    names = list(config.parameters)
    choices = [config.parameters[name].values or [] for name in names]
    flights = itertools.product(
        config.scenarios, config.autopilots, itertools.product(*choices), range(config.repeats)
    )
    for number, (scenario, autopilot, values, repeat) in enumerate(flights):
        chosen = dict(zip(names, values, strict=True))
        yield _spec(config, number, scenario, autopilot, config.seed + repeat, chosen)


def _drawn(config: CampaignConfig, count: int) -> Iterator[RunSpec]:
    for number in range(count):
        rng = np.random.default_rng([config.seed, number])
        scenario = config.scenarios[int(rng.integers(len(config.scenarios)))]
        autopilot = config.autopilots[int(rng.integers(len(config.autopilots)))]
        seed = int(rng.integers(_LARGEST_SEED))
        values = {name: _value(one, rng) for name, one in config.parameters.items()}
        yield _spec(config, number, scenario, autopilot, seed, values)


def _value(parameter: CampaignParameter, rng: np.random.Generator) -> Value:
    if parameter.values is not None:
        return parameter.values[int(rng.integers(len(parameter.values)))]
    low, high = parameter.between or (0.0, 0.0)
    return significant(rng.uniform(low, high))


def _spec(
    config: CampaignConfig,
    number: int,
    scenario: str,
    autopilot: str,
    seed: int,
    values: dict[str, Value],
) -> RunSpec:
    assigned = [
        pair for name, one in values.items() for pair in config.parameters[name].assignments(one)
    ]
    scene = [f"{key.removeprefix(SCENE)}={one}" for key, one in assigned if key.startswith(SCENE)]
    overrides = [f"{key}={one}" for key, one in assigned if not key.startswith(SCENE)]
    return RunSpec(
        number,
        scenario,
        autopilot,
        seed,
        str(config.vision),
        (*config.set, *overrides),
        (*config.scene, *scene),
        values,
        None if config.config is None else str(config.config),
    )
