"""A fault with the time at which it is wanted: `NAME[@time[:duration]]`."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from follower.faults.catalogue import fault_named
from follower.faults.fault import Fault
from follower_control.strict_yaml import SettingsError

_TEXT = re.compile(r"([^@:\s]+)(?:@(\d+(?:\.\d*)?))?(?::(\d+(?:\.\d*)?))?")


@dataclass(frozen=True, slots=True)
class PlannedFault:
    """A fault and when it comes.

    Attributes:
        fault: which.
        at_s: time of the scenario, None when the fault itself says so.
        for_s: how long.
    """

    fault: Fault
    at_s: float | None
    for_s: float

    @classmethod
    def of(cls, fault: Fault) -> PlannedFault:
        """Plan a fault as the catalogue says."""
        return cls(fault, None, fault.for_s)

    @classmethod
    def parse(cls, text: str) -> PlannedFault:
        """Read `NAME`, `NAME@time` or `NAME@time:duration`, in seconds.

        Raises:
            SettingsError: it is none of them.
        """
        match = _TEXT.fullmatch(text)
        if match is None:
            raise SettingsError(f"--fault {text}: write NAME, NAME@time or NAME@time:duration")
        try:
            fault = fault_named(match[1])
        except ValueError as error:
            raise SettingsError(f"--fault {text}: {error}") from None
        at_s = None if match[2] is None else float(match[2])
        for_s = fault.for_s if match[3] is None else float(match[3])
        return cls(fault, at_s, for_s)

    def __str__(self) -> str:
        at = "" if self.at_s is None else f"@{self.at_s:g}"
        changed = self.for_s != self.fault.for_s and math.isfinite(self.for_s)
        return self.fault.name + at + (f":{self.for_s:g}" if changed else "")
