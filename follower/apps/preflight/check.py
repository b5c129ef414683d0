"""One check of the table, and what came of it."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Generic, TypeAlias, TypeVar

from follower.links.status import LinkStatus
from follower.links.vehicle_health import VehicleHealth
from follower.settings.settings import Settings
from follower_control.vehicle.state import VehicleState


class PreflightVerdict(StrEnum):
    """How a check came out."""

    PASS = "pass"  # noqa: S105  not a password
    WARN = "warn"
    FAIL = "fail"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class PreflightFinding:
    """One check's answer.

    Attributes:
        verdict: how it came out.
        why: what was found.
        todo: what to do about it, "" if nothing.
    """

    verdict: PreflightVerdict
    why: str
    todo: str = ""


def passed(why: str) -> PreflightFinding:
    """Return that all is well."""
    return PreflightFinding(PreflightVerdict.PASS, why)


def warned(why: str, todo: str) -> PreflightFinding:
    """Return that it can be flown with, but should not stay so."""
    return PreflightFinding(PreflightVerdict.WARN, why, todo)


def failed(why: str, todo: str) -> PreflightFinding:
    """Return that it must not be flown with."""
    return PreflightFinding(PreflightVerdict.FAIL, why, todo)


def graded(text: str, todo: str, *, good: bool, usable: bool) -> PreflightFinding:
    """Return that all is well; else what to do, and whether it can be flown with."""
    if good:
        return passed(text)
    return warned(text, todo) if usable else failed(text, todo)


def unknown(why: str, todo: str = "") -> PreflightFinding:
    """Return that nobody knows."""
    return PreflightFinding(PreflightVerdict.UNKNOWN, why, todo)


@dataclass(frozen=True, slots=True)
class CameraReading:
    """What the camera gave while it was watched.

    Attributes:
        source: what it was asked for, without a password.
        problem: why frames do not come, "" if they do.
        size: width and height in pixels, None without a frame.
        frames: how many came.
        interval_s: median time between two captures.
        worst_interval_s: the longest.
        jitter_s: 95th percentile of an interval's distance from the median.
        age_s: 95th percentile of a frame's age when it was taken.
        contrast: standard deviation of the newest frame's grey values, 0 to 127.
        repeats: frames that were the same as the one before, to the last bit.
    """

    source: str = ""
    problem: str = ""
    size: tuple[int, int] | None = None
    frames: int = 0
    interval_s: float = math.nan
    worst_interval_s: float = math.nan
    jitter_s: float = math.nan
    age_s: float = math.nan
    contrast: float = math.nan
    repeats: int = 0


@dataclass(frozen=True, slots=True)
class ComputerReading:
    """The companion computer's state; None is what could not be read.

    Attributes:
        free_bytes: room on the recording's disk.
        folder: where it is.
        temperature_c: the hottest part's.
        throttled: the Raspberry Pi's flags, as `vcgencmd get_throttled` gives them.
        load: processes that want to run, over the cores.
        writable: the recording can be put there.
    """

    free_bytes: int | None = None
    folder: str = "."
    temperature_c: float | None = None
    throttled: int | None = None
    load: float | None = None
    writable: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class CompanionSnapshot:
    """All that is known at one time of the companion computer, without a vehicle.

    Attributes:
        settings: that would be flown with.
        camera: see there.
        models: networks' files and whether each is "good", "missing" or "wrong".
        lens_given: the settings name a field of view or a focal length.
        computer: see there.
    """

    settings: Settings
    camera: CameraReading = CameraReading()
    models: Mapping[str, str] = field(default_factory=dict)
    lens_given: bool = True
    computer: ComputerReading = ComputerReading()


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot(CompanionSnapshot):
    """All that is known at one time before a flight.

    Attributes:
        now_s: on the system's clock.
        link: how it is.
        vehicle: its newest telemetry.
        health: what it reports about itself.
        attitude_age_s: of the oldest attitude that control would have used, on our clock.
        attitude_repeats: its numbers did not change although they came with new times.
        parameters: of the autopilot, by name.
    """

    now_s: float
    link: LinkStatus
    vehicle: VehicleState = field(default_factory=VehicleState)
    health: VehicleHealth = field(default_factory=VehicleHealth)
    attitude_age_s: float = math.inf
    attitude_repeats: bool = False
    parameters: Mapping[str, float] = field(default_factory=dict)


BOTH = ("px4", "ardupilot")
Known = TypeVar("Known", contravariant=True)
"""What a check looks at: a snapshot with a vehicle, or without."""
Judge: TypeAlias = Callable[[Known], PreflightFinding]


@dataclass(frozen=True, slots=True)
class PreflightCheck(Generic[Known]):
    """One check.

    Attributes:
        name: for `--skip-preflight`.
        group: heading under which it stands.
        rule: what it wants, in a sentence.
        judge: looks at the snapshot.
        needed: nobody flies while it fails or is unknown.
        autopilots: for which it is meant.
        parameters: of the autopilot that it looks at; the first one that there is.
    """

    name: str
    group: str
    rule: str
    judge: Judge[Known]
    needed: bool = True
    autopilots: tuple[str, ...] = BOTH
    parameters: tuple[str, ...] = ()


class CheckGroup(Generic[Known]):
    """Checks under one heading, in the order in which they are defined."""

    def __init__(self, title: str) -> None:
        self._title = title
        self.checks: list[PreflightCheck[Known]] = []

    def check(
        self,
        name: str,
        rule: str,
        *,
        needed: bool = True,
        autopilots: tuple[str, ...] = BOTH,
        parameters: tuple[str, ...] = (),
    ) -> Callable[[Judge[Known]], Judge[Known]]:
        """Return a decorator that makes a function the judge of a check; see `PreflightCheck`."""

        def add(judge: Judge[Known]) -> Judge[Known]:
            one = PreflightCheck(name, self._title, rule, judge, needed, autopilots, parameters)
            self.checks.append(one)
            return judge

        return add


@dataclass(frozen=True, slots=True)
class PreflightResult:
    """What came of a check.

    Attributes:
        check: which one.
        finding: what it said.
        skipped: the user takes the responsibility.
    """

    check: PreflightCheck[Any]
    finding: PreflightFinding
    skipped: bool = False

    @property
    def refuses(self) -> bool:
        """Whether nobody may fly because of it."""
        bad = self.finding.verdict in (PreflightVerdict.FAIL, PreflightVerdict.UNKNOWN)
        return bad and self.check.needed and not self.skipped

    @property
    def said(self) -> str:
        """What was found and what to do."""
        return "; ".join(filter(None, (self.finding.why, self.finding.todo)))


def refusals(results: Iterable[PreflightResult]) -> list[str]:
    """Return what the checks that refuse a flight say, a line for all that say the same."""
    names: dict[str, list[str]] = {}
    for result in results:
        if result.refuses:
            names.setdefault(result.said, []).append(result.check.name)
    return [f"{', '.join(those)}: {said}" for said, those in names.items()]


class PreflightError(ValueError):
    """Preflight checks refuse the flight; the message says what to mend, a line for each.

    Args:
        results: of all checks.

    Attributes:
        failed: those that refuse it.

    Examples:
        >>> import follower
        >>> try:  # the lens is not described, and nobody has done the sign test
        ...     with follower.Pursuit("udpin:0.0.0.0:14540", camera=0) as pursuit:
        ...         pursuit.wait()
        ... except follower.PreflightError as error:
        ...     print([result.check.name for result in error.failed])
        [...]
    """

    def __init__(self, results: Iterable[PreflightResult]) -> None:
        self.failed = tuple(result for result in results if result.refuses)
        said = "\n".join(refusals(self.failed))
        super().__init__(f"preflight: {said or 'the camera gave no frame'}")
