"""Which runs a campaign has: all combinations, or as many as wanted, drawn from its seed."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from follower.campaign.campaign_config import SCENE, CampaignConfig, Parameter
from follower.campaign.run_spec import RunSpec, Value

_LARGEST_SEED = 1_000_000


def planned(config: CampaignConfig) -> list[RunSpec]:
    """Return the campaign's runs. The first ones are the same however many are drawn."""
    return list(_combined(config) if config.runs is None else _drawn(config, config.runs))


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
