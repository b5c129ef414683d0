"""Faults in `follower sim`: what is set up before the flight, and reported after it."""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from follower.links.packet_parser import PacketReader
from follower.links.signing import Signer, SigningKey
from follower.settings.settings import Settings, load_settings
from follower.simulation.faults.fault import PlannedFault
from follower.simulation.faults.injector import FaultInjector
from follower.simulation.faults.judge import FaultCase, FaultMetrics, FaultVerdict, judge
from follower.simulation.flight import SimulatedFlight, epoch_ns
from follower_control.common.transport import Transport, WrappedTransport
from follower_vision.clock import Clock

_SECRET = bytes(range(1, 33))


class SigningPeer(WrappedTransport):
    """A transport of the autopilot's that signs what leaves and drops what is not signed."""

    def __init__(self, inner: Transport, clock: Clock) -> None:
        super().__init__(inner)
        self._clock = clock
        self._signer = Signer(SigningKey(_SECRET), epoch_ns(clock))
        self._reader = PacketReader()

    def send(self, data: bytes) -> None:
        """Send one packet, signed."""
        super().send(self._signer.sign(data, self._clock.now()))

    def receive(self) -> bytes:
        """Return what has arrived with the right signature."""
        now_s = self._clock.now()
        packets = self._reader.feed(super().receive())
        return b"".join(p.data for p in packets if self._signer.refusal(p, now_s) is None)


Ends = tuple[Transport, Transport]

_NOT_JUDGED = "(Its own sentence is judged only where it comes alone and as long as listed.)"


@contextmanager
def as_faults_want(
    planned: Sequence[PlannedFault], settings: Settings, ends: Ends, clock: Clock
) -> Iterator[tuple[Settings, Ends]]:
    """Give settings and transports as the faults want them: theirs, and a signed link's."""
    overrides = [override for one in planned for override in one.fault.settings]
    if overrides:
        settings = load_settings(base=settings.model_dump(), overrides=overrides)
    if not any(one.fault.signed for one in planned):
        yield settings, ends
        return
    with tempfile.TemporaryDirectory() as folder:
        key = Path(folder) / "fault.key"
        key.write_text(_SECRET.hex())
        key.chmod(0o600)
        link = settings.model_dump()["link"] | {"signing_key_file": str(key)}
        signed = Settings.model_validate(settings.model_dump() | {"link": link})
        yield signed, (ends[0], SigningPeer(ends[1], clock))


def verdicts(
    planned: Sequence[PlannedFault],
    flight: SimulatedFlight,
    injector: FaultInjector,
    error: str = "",
) -> list[FaultVerdict]:
    """Judge a flight that is over, fault by fault.

    Where there are several, or one lasts as long as the user chose, each is checked only against
    the rules that always hold: its own sentence is about itself as it stands in the catalogue.
    """
    begun = {one: from_s for one, from_s, _ in injector.schedule.spans}
    cases = (
        FaultCase(
            one,
            begun.get(one),
            begun.get(one, 0.0) + one.for_s,
            injector.evidence,
            flight.log.controls,
            flight.truth,
            flight.settings.envelope,
            len(planned) == 1 and one.for_s == one.fault.for_s,
            error,
            injector.realtime,
        )
        for one in planned
    )
    return [judge(case) for case in cases]


def describe_verdict(verdict: FaultVerdict) -> str:
    """Return a verdict in a line."""
    passed = "as it must be" if verdict.must else "what always holds was kept"
    came = passed if verdict.passed else "; ".join(verdict.failures)
    must = f"({verdict.must})" if verdict.must else _NOT_JUDGED
    return f"Fault {verdict.fault}: {came}. {must} {_measured(verdict.figures)}".rstrip()


def _measured(figures: FaultMetrics) -> str:
    named = (
        ("hold on the wire", figures.hold_s, "s"),
        ("at rest", figures.rest_s, "s"),
        ("excursion", figures.excursion_m, "m"),
        ("follows again", figures.back_s, "s"),
    )
    parts = [f"{name} {value:.2f} {unit}" for name, value, unit in named if value is not None]
    return f"Measured: {', '.join(parts)}." if parts else ""
