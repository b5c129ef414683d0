"""What ground stations receive of a flight, read from its log while it goes on."""

from dataclasses import dataclass

from follower.flight.log import ControlRecord, FlightLog
from follower.flight.operator_requests import OperatorRequests
from follower.links.link import Link
from follower_control.servo.position_fix import TargetPosition, target_fix
from follower_vision.trackers.track import Track

_STALE_S = 1.0


@dataclass(frozen=True, slots=True)
class FlightView:
    """Reads what the stages have left in the log; may be used by any thread.

    Attributes:
        log: grows on other threads meanwhile.
        link: the one to the autopilot.
        requests: what operators want goes there.
        size: width and height of the frames.
    """

    log: FlightLog
    link: Link
    requests: OperatorRequests
    size: tuple[int, int]

    def track(self, now_s: float) -> Track | None:
        """Return vision's newest answer unless it is more than one second old."""
        record = self.log.tracks[-1] if self.log.tracks else None
        if record is None or now_s - record.captured_s > _STALE_S:
            return None
        return record.track

    def step(self, now_s: float) -> ControlRecord | None:
        """Return the newest control step unless it is more than one second old."""
        record = self.log.controls[-1] if self.log.controls else None
        return None if record is None or now_s - record.time_s > _STALE_S else record


@dataclass(frozen=True, slots=True)
class CameraOptics:
    """The camera as a ground station sees it.

    Attributes:
        fov_deg: horizontal field of view.
        rate_hz: frames a second.
        stream_size: width and height of the video, where they are not those of the frames.
        bitrate_bit_s: of the video; 0 where nobody knows.
    """

    fov_deg: float
    rate_hz: float
    stream_size: tuple[int, int] | None = None
    bitrate_bit_s: int = 0


@dataclass(frozen=True, slots=True)
class GeoPosition:
    """A target's fix on the globe.

    Attributes:
        latitude_deg: north is positive.
        longitude_deg: east is positive.
        altitude_m: above mean sea level.
        above_home_m: above the origin of local positions.
        fix: in local metres.
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    above_home_m: float
    fix: TargetPosition


def target_place(view: FlightView, now_s: float) -> GeoPosition | None:
    """Return the target's latitude, longitude (degrees) and altitude (m), None if not known now."""
    step, altitude_m = view.step(now_s), view.link.altitude_msl_m
    if step is None or step.estimate is None or altitude_m is None:
        return None
    fix = target_fix(step.estimate, step.vehicle, view.requests.settings.servo)
    origin, position = step.vehicle.origin, step.vehicle.position
    if fix is None or origin is None or position is None:
        return None
    north, east, down = fix.position_m
    above_us_m = position.down_m - down
    return GeoPosition(*origin.geolocated(north, east), altitude_m + above_us_m, -down, fix)
