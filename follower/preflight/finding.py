"""What a check says."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """How a check came out."""

    PASS = "pass"  # noqa: S105  not a password
    WARN = "warn"
    FAIL = "fail"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Finding:
    """One check's answer.

    Attributes:
        verdict: how it came out.
        why: what was found.
        todo: what to do about it, "" if nothing.
    """

    verdict: Verdict
    why: str
    todo: str = ""


def passed(why: str) -> Finding:
    """Return that all is well."""
    return Finding(Verdict.PASS, why)


def warned(why: str, todo: str) -> Finding:
    """Return that it can be flown with, but should not stay so."""
    return Finding(Verdict.WARN, why, todo)


def failed(why: str, todo: str) -> Finding:
    """Return that it must not be flown with."""
    return Finding(Verdict.FAIL, why, todo)


def unknown(why: str, todo: str = "") -> Finding:
    """Return that nobody knows."""
    return Finding(Verdict.UNKNOWN, why, todo)
