"""Which runs a campaign has: all combinations, or as many as wanted, drawn from its seed."""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from follower.campaign.campaign_config import SCENE, CampaignConfig, Parameter
from follower.campaign.run_spec import RunSpec, Value
from follower.configs import find_scenario
from follower_control.strict_yaml import SettingsError

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
    contents = {one: _contents(config, one) for one in config.scenarios}
    specs = _combined(config) if config.runs is None else _drawn(config, config.runs)
    return [replace(spec, contents=contents[spec.scenario]) for spec in specs]


def _count(config: CampaignConfig) -> int:
    if config.runs is not None:
        return config.runs
    choices = (len(one.values or []) for one in config.parameters.values())
    kinds = len(config.scenarios) * len(config.autopilots)
    return kinds * math.prod(choices) * config.repeats


def _contents(config: CampaignConfig, scenario: str) -> str:
    """Tell the text of a scenario and of the settings from others: changed, they fly otherwise."""
    digest = hashlib.sha256()
    for path in (find_scenario(scenario), config.config):
        try:
            digest.update(b"" if path is None else hashlib.sha256(path.read_bytes()).digest())
        except OSError as error:
            raise SettingsError(f"{path}: it cannot be read: {error.strerror}") from error
    return digest.hexdigest()[:16]


def _combined(config: CampaignConfig) -> Iterator[RunSpec]:
    names = list(config.parameters)
    choices = [config.parameters[name].values or [] for name in names]
    combinations = itertools.product(config.scenarios, config.autopilots, *choices)
    numbers = itertools.count()
    for scenario, autopilot, *values in combinations:
        for repeat in range(config.repeats):
            number, seed = next(numbers), config.seed + repeat
            chosen = dict(zip(names, values, strict=True))
            yield _spec(config, number, str(scenario), str(autopilot), seed, chosen)


def _drawn(config: CampaignConfig, count: int) -> Iterator[RunSpec]:
    for number in range(count):
        rng = np.random.default_rng([config.seed, number])
        scenario = config.scenarios[int(rng.integers(len(config.scenarios)))]
        autopilot = config.autopilots[int(rng.integers(len(config.autopilots)))]
        seed = int(rng.integers(_LARGEST_SEED))
        values = {name: _value(one, rng) for name, one in config.parameters.items()}
        yield _spec(config, number, scenario, autopilot, seed, values)


def _value(parameter: Parameter, rng: np.random.Generator) -> Value:
    if parameter.values is not None:
        return parameter.values[int(rng.integers(len(parameter.values)))]
    low, high = parameter.between or (0.0, 0.0)
    return float(f"{rng.uniform(low, high):.4g}")


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
