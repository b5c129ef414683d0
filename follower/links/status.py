"""How well a link works, for displays, reports and the preflight check."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from follower.links.request_scheduler import MessageRate


@dataclass(frozen=True, slots=True)
class LinkStatus:
    """The state of a link; None where nothing is known.

    Attributes:
        kind: "pymavlink" or "mavsdk".
        vehicle_id: the vehicle's MAVLink system id.
        autopilot: "px4", "ardupilot" or "unknown".
        problem: why there is no vehicle, in words; "" if there is one or no heartbeat came.
        round_trip_s: from a question to our seeing its answer, median of the last ten.
        clock_error_s: the most by which a time of the autopilot's can be wrong on our clock.
        clock_pace: seconds that pass on the autopilot's clock in one of ours.
        clock_restarts: how often the autopilot's clock jumped: it was restarted.
        rates: of the messages that we want.
        received: packets that were believed, whoever sent them.
        of_vehicle: those of them that the vehicle's autopilot sent.
        lost: packets of the vehicle that never came, by their sequence numbers.
        refused: packets that were not believed, by the reason.
        skipped_bytes: bytes that belonged to no packet.
        signed: whether the link is signed.
    """

    kind: str
    vehicle_id: int | None = None
    autopilot: str = "unknown"
    problem: str = ""
    round_trip_s: float | None = None
    clock_error_s: float | None = None
    clock_pace: float | None = None
    clock_restarts: int = 0
    rates: tuple[MessageRate, ...] = ()
    received: int = 0
    of_vehicle: int = 0
    lost: int = 0
    refused: Mapping[str, int] = field(default_factory=dict)
    skipped_bytes: int = 0
    signed: bool = False

    @property
    def lost_share(self) -> float:
        """The share of the vehicle's packets that never came, 0 to 1."""
        return self.lost / (self.lost + self.of_vehicle) if self.of_vehicle else 0.0

    def line(self) -> str:
        """Return it in one line."""
        if self.problem:
            return self.problem
        if self.vehicle_id is None:
            return f"{self.kind}: no heartbeat of a vehicle received{self._doubts()}"
        parts = [f"{self.kind} to {self.autopilot} {self.vehicle_id}"]
        parts += [] if self.round_trip_s is None else [f"{1e3 * self.round_trip_s:.0f} ms and back"]
        parts += [f"{rate.name.lower()} {rate.measured_hz:.0f} Hz" for rate in self.rates[:2]]
        parts += [f"{self.lost_share:.1%} lost"] if self.lost else []
        return ", ".join(parts) + self._doubts()

    def _doubts(self) -> str:
        doubts = [f"{count} refused: {reason}" for reason, count in self.refused.items()]
        if self.skipped_bytes and not self.received:
            doubts.append(f"{self.skipped_bytes} bytes came, but no MAVLink: wrong baud rate?")
        return f" ({'; '.join(doubts)})" if doubts else ""
