"""The one interface of all links to an autopilot."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

from follower.links.link_status import LinkStatus
from follower.links.operator_commands import OperatorCommand
from follower.links.packet_port import PacketPort
from follower.links.parameter_reader import ParameterReader
from follower.links.vehicle_health import VehicleHealth
from follower_control.gimbal import GimbalRates
from follower_control.setpoint import VelocitySetpoint
from follower_control.vehicle import Attitude, VehicleState


class Link(Protocol):
    """A companion computer's end of a link to one vehicle.

    Stepped by `poll`, which never waits and never raises for anything that comes over the link.
    Telemetry that is not finite is dropped, so that it grows stale instead of being believed.
    """

    @property
    def state(self) -> VehicleState:
        """The newest of everything that the vehicle told."""
        ...

    @property
    def attitudes(self) -> Sequence[Attitude]:
        """The attitudes that came with the last `poll`, oldest first."""
        ...

    @property
    def altitude_msl_m(self) -> float | None:
        """Height above mean sea level, None before it is known."""
        ...

    @property
    def connected(self) -> bool:
        """Whether it is clear which vehicle is ours."""
        ...

    @property
    def autopilot_name(self) -> str:
        """What kind of autopilot answers: "px4", "ardupilot", or "unknown" before it does."""
        ...

    @property
    def health(self) -> VehicleHealth:
        """What the vehicle said about its health; little before `watch_health`."""
        ...

    @property
    def parameters(self) -> ParameterReader | None:
        """The parameters asked for, None before the vehicle is found."""
        ...

    @property
    def vehicle_id(self) -> int | None:
        """The vehicle's MAVLink system id, None before it is found."""
        ...

    def open_port(self, message_ids: frozenset[int]) -> PacketPort:
        """Return a port for another component on this link; there is one at a time."""
        ...

    def watch_health(self) -> None:
        """From now on have the vehicle tell its firmware and, once a second, its health."""
        ...

    def use_gimbal(self, device: int) -> None:
        """From now on find the gimbal, take its control and have its attitude told."""
        ...

    def turn_gimbal(self, rates: GimbalRates) -> None:
        """Turn the gimbal, if there is one and nobody else controls it."""
        ...

    def read_parameters(self, names: Iterable[str]) -> None:
        """Have these parameters read; nothing happens before the vehicle is found."""
        ...

    def status(self, now_s: float) -> LinkStatus:
        """Return how well the link works."""
        ...

    def poll(self, now_s: float) -> None:
        """Take in what has arrived and send what is due.

        Where no setpoint is sent between two polls, the stream of setpoints has ended.
        """
        ...

    def take_notes(self) -> list[str]:
        """Return the autopilot's texts, refusals and the link's troubles since last time."""
        ...

    def send(self, setpoint: VelocitySetpoint) -> None:
        """Send one velocity setpoint; nothing is sent before the vehicle is found.

        Raises:
            ValueError: a number is not finite. The envelope never lets that come so far.
        """
        ...

    def arm(self) -> None:
        """Ask the autopilot to arm."""
        ...

    def take_off(self, height_m: float) -> None:
        """Ask for a take-off to `height_m` above the ground the vehicle stands on."""
        ...

    def take_commands(self) -> Sequence[OperatorCommand]:
        """Return the commands addressed to us since last time."""
        ...

    def answer(self, command: OperatorCommand, accepted: bool) -> None:
        """Acknowledge a command to us."""
        ...

    def enter_mode(self, name: str) -> None:
        """Ask for a mode by the autopilot's own name.

        Raises:
            ValueError: the autopilot has no mode of that name.
        """
        ...

    def enter_setpoint_mode(self) -> None:
        """Ask for OFFBOARD or GUIDED."""
        ...

    def enter_hold_mode(self) -> None:
        """Ask for the mode in which the autopilot stands still by itself."""
        ...

    def close(self) -> None:
        """End the stream and close the transport."""
        ...
