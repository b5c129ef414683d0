"""The settings that may change in flight, as parameters of at most 16 characters.

The names are made from the settings' own, word by word, so that a new setting has one by itself:
servo.range.derivative_filter_s is SRV_RNG_DFLT. What is no number is a number here: a truth is 0 or
1, an enumeration counts its members from 0, and none is -1000.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Any

from follower.setting_change import LiveKey, live_keys, value_at
from follower.settings import Settings
from follower_control.strict_yaml import SettingsError

NONE = -1000.0
MOST_CHARACTERS = 16
_UNITS = ("_m_s2", "_m_s3", "_deg_s", "_m_s", "_deg", "_m", "_s")
_WORDS = {
    "servo": "SRV",
    "search": "SRCH",
    "envelope": "ENV",
    "supervisor": "SUP",
    "azimuth": "AZ",
    "elevation": "EL",
    "range": "RNG",
    "bearing": "BRG",
    "orbit": "ORB",
    "overhead": "OVH",
    "derivative": "D",
    "filter": "FLT",
    "tracking": "TRK",
    "tolerance": "TOL",
    "bumpless": "BMP",
    "distance": "DIST",
    "target": "TGT",
    "middle": "MID",
    "height": "HGT",
    "centred": "CTR",
    "forward": "FWD",
    "backward": "BCK",
    "vertical": "VRT",
    "sideways": "SWY",
    "speed": "SPD",
    "acceleration": "ACC",
    "rate": "RT",
    "error": "ERR",
    "course": "CRS",
    "clearance": "CLR",
    "descent": "DSC",
    "climb": "CLB",
    "ceiling": "CEIL",
    "fence": "FNC",
    "radius": "RAD",
}


@dataclass(frozen=True, slots=True)
class Parameter:
    """One setting as a parameter.

    Attributes:
        name: at most 16 characters; what is before the first "_" is its group.
        live: the setting.
    """

    name: str
    live: LiveKey

    @property
    def members(self) -> tuple[Any, ...]:
        """The values that it counts, nothing for a number."""
        if self.live.kind is bool:
            return False, True
        return tuple(self.live.kind) if issubclass(self.live.kind, Enum) else ()

    def number(self, settings: Settings) -> float:
        """Return its value in these settings, as the nearest 32-bit number."""
        value = value_at(settings, self.live.key)
        if value is None:
            return NONE
        members = self.members
        return float32(members.index(value) if members else value)

    def value(self, number: float) -> Any:
        """Return what a setting becomes by this number.

        Raises:
            SettingsError: it stands for no value.
        """
        if number == NONE and self.live.optional:
            return None
        if self.members:
            if number not in range(len(self.members)):
                most = len(self.members) - 1
                raise SettingsError(f"{self.name} is a whole number from 0 to {most}")
            return self.members[int(number)]
        return shortest(number)


@cache
def parameters() -> tuple[Parameter, ...]:
    """Return all parameters, in the order of the settings."""
    keys = live_keys()
    short = [_name(one.key, with_unit=False) for one in keys]
    names = [
        name if short.count(name) == 1 else _name(one.key, with_unit=True)
        for one, name in zip(keys, short, strict=True)
    ]
    return tuple(map(Parameter, names, keys))


@cache
def by_name() -> dict[str, Parameter]:
    """Return all parameters by their names."""
    return {one.name: one for one in parameters()}


def float32(value: float) -> float:
    """Return the nearest 32-bit number; infinite beyond them."""
    try:
        (nearest,) = struct.unpack("<f", struct.pack("<f", value))
    except OverflowError:
        return float("inf") if value > 0 else float("-inf")
    return float(nearest)


def shortest(number: float) -> float:
    """Return the decimal with the fewest digits whose 32-bit number this is: 0.7, not 0.69999..."""
    for digits in range(1, 10):
        decimal = float(f"{number:.{digits}g}")
        if float32(decimal) == float32(number):
            return decimal
    return number


def _name(key: str, with_unit: bool) -> str:
    unit = next((ending for ending in _UNITS if key.endswith(ending)), "")
    parts = (key.removesuffix(unit) + (unit if with_unit else "")).split(".")
    return "_".join(map(_abbreviated, parts))


def _abbreviated(words: str) -> str:
    return "".join(_WORDS.get(word, word.upper()) for word in words.split("_"))
