"""Which of the systems that send heartbeats is our vehicle."""

from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

_FORGET_S = 10.0
_MOST_NAMED = 10
NO_VEHICLES = {
    mavlink.MAV_TYPE_GCS,
    mavlink.MAV_TYPE_ANTENNA_TRACKER,
    mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
    mavlink.MAV_TYPE_GIMBAL,
    mavlink.MAV_TYPE_ADSB,
    mavlink.MAV_TYPE_CAMERA,
    mavlink.MAV_TYPE_CHARGING_STATION,
}
"""MAV_TYPE of what sends heartbeats and flies nothing, whatever it says its autopilot is."""
AUTOPILOTS = {
    int(mavlink.MAV_AUTOPILOT_PX4): "px4",
    int(mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA): "ardupilot",
}


@dataclass(frozen=True, slots=True)
class FoundVehicle:
    """A vehicle with an autopilot that we can talk to.

    Attributes:
        system: its MAVLink system id; its autopilot is component 1.
        autopilot: MAV_AUTOPILOT.
    """

    system: int
    autopilot: int

    @property
    def autopilot_name(self) -> str:
        """What kind of autopilot it is, "px4" or "ardupilot"."""
        return AUTOPILOTS[self.autopilot]

    def __str__(self) -> str:
        return f"{self.system} ({self.autopilot_name})"


def vehicle_of(system: int, component: int, kind: int, autopilot: int) -> FoundVehicle | None:
    """Return the vehicle whose heartbeat has this sender, MAV_TYPE and MAV_AUTOPILOT, if any."""
    is_autopilot = autopilot in AUTOPILOTS and component == mavlink.MAV_COMP_ID_AUTOPILOT1
    if system == 0 or not is_autopilot or kind in NO_VEHICLES:
        return None
    return FoundVehicle(system, autopilot)


class VehicleFinder:
    """Collects heartbeats until it is clear which vehicle is ours; it never guesses.

    Args:
        wanted: the system id to take, None for the only one that there is.
        listen_s: how many seconds to listen for others after the first.
    """

    def __init__(self, wanted: int | None, listen_s: float) -> None:
        self._wanted = wanted
        self._listen_s = listen_s
        self._first_s: float | None = None
        self._beats: dict[int, tuple[FoundVehicle, float]] = {}

    def take(self, vehicle: FoundVehicle, now_s: float) -> None:
        """Take a vehicle's heartbeat."""
        self._first_s = now_s if self._first_s is None else self._first_s
        self._beats[vehicle.system] = vehicle, now_s

    def vehicles(self, now_s: float) -> list[FoundVehicle]:
        """Return all whose heartbeats came in the last 10 s, by their ids."""
        vehicles = list(self._beats.values())  # displays ask on other threads
        lately = [v for v, beat_s in vehicles if now_s - beat_s < _FORGET_S]
        return sorted(lately, key=lambda vehicle: vehicle.system)

    def found(self, now_s: float) -> FoundVehicle | None:
        """Return the vehicle once it is clear, at `now_s` (seconds), which one it is."""
        vehicles = self.vehicles(now_s)
        if self._wanted is not None:
            return next((v for v in vehicles if v.system == self._wanted), None)
        return vehicles[0] if len(vehicles) == 1 and self._has_listened(now_s) else None

    def problem(self, now_s: float) -> str:
        """Return in words why there is no vehicle although some send heartbeats, else ""."""
        vehicles = self.vehicles(now_s)
        names = ", ".join(map(str, vehicles[:_MOST_NAMED]))
        missed = self._wanted is not None and self.found(now_s) is None
        if missed and vehicles and self._has_listened(now_s):
            return f"system {self._wanted} sends no heartbeat, but {names}: set link.vehicle_id"
        if self._wanted is None and len(vehicles) > 1:
            return (
                f"several vehicles send heartbeats: {names}; choose one, "
                f"for example --set link.vehicle_id={vehicles[0].system}"
            )
        return ""

    def _has_listened(self, now_s: float) -> bool:
        return self._first_s is not None and now_s - self._first_s >= self._listen_s
