"""What a campaign's YAML file may say."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from follower.campaign.goals import Goals
from follower.campaign.run_spec import Value
from follower.configs import configs_folder, find_scenario
from follower.sight import Sight
from follower_control.strict_yaml import SettingsError, parse, read_mapping

SCENE = "scene."
"""What a key of the scenario begins with; the others are settings of the follower."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Parameter(_Section):
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
        if self.between is not None and not self.between[0] < self.between[1]:
            raise ValueError("a parameter lies `between` a smaller and a larger number")
        return self

    @property
    def key_names(self) -> tuple[str, ...]:
        """What is set by it."""
        return tuple(self.keys) if self.key is None else (self.key,)

    def _check_values(self, values: Sequence[Value]) -> None:
        if not values:
            raise ValueError("a parameter's `values` are at least one")
        if len({str(value) for value in values}) < len(values):
            raise ValueError("a parameter's `values` differ: the same flights would count twice")
        if self.keys and not all(type(value) in (int, float) for value in values):
            raise ValueError("with `keys`, which take them times their factors, values are numbers")

    def assignments(self, value: Value) -> list[tuple[str, Value]]:
        """Return each key with the value that it takes."""
        if self.key is not None:
            return [(self.key, value)]
        return [(key, _significant(factor * float(value))) for key, factor in self.keys.items()]


class OptimiseSettings(_Section):
    """A search for settings with a smaller cost."""

    trials: Annotated[int, Field(ge=1)] = 40
    runs_per_trial: Annotated[int, Field(ge=1)] = 24
    """Each trial flies the same runs, the campaign's first ones."""
    seed: int = 0
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
    seed: Annotated[int, Field(ge=0)] = 1
    vision: Sight = Sight.PIXELS
    config: Path | None = None
    """A file of settings, such as `follower tune` writes; beside the campaign's file."""
    set: list[str] = Field(default_factory=list)
    """Settings that all runs have, `key=value` each."""
    scene: list[str] = Field(default_factory=list)
    """Keys of the scenarios likewise."""
    parameters: dict[str, Parameter] = Field(default_factory=dict)
    goals: Goals = Goals()
    optimise: OptimiseSettings | None = None

    @field_validator("scenarios")
    @classmethod
    def _exist(cls, names: list[str]) -> list[str]:
        for name in names:
            if not find_scenario(name).exists():
                raise ValueError(f"{name}: there is no such file")
        return names

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
        result["scenarios"] = [_scenario(one, folder) for one in result["scenarios"]]
    return result


def _scenario(name: Any, folder: Path) -> Any:
    is_file = isinstance(name, str) and name.endswith((".yaml", ".yml"))
    return str(folder / name) if is_file else name


def _significant(value: float) -> float:
    """Round to four digits, so that command lines stay short."""
    return float(f"{value:.4g}")
