"""The two ways to fly a simulated flight: on a simulated clock, and in real time."""

from collections.abc import Callable
from contextlib import nullcontext

from follower.flight.lockstep import Lockstep, Pacer
from follower.flight.threads import RealtimeRun, few_collections
from follower.simulation.flight import SimulatedFlight
from follower_sim.autopilot.autopilot import autopilot_thread
from follower_sim.camera import Exposure, SimCamera
from follower_sim.vehicle.vehicle import STEP_S
from follower_vision.clock import Clock, SimulatedClock
from follower_vision.images.frame import Frame
from follower_vision.sources.frame_source import ClosesItself

VISION_DELAY_S = 0.012
"""How long vision is held to take in lockstep, where its own time does not count."""
SHOW_EVERY_S = 0.1
PACE_S = 0.01


def fly_lockstep(
    flight: SimulatedFlight,
    clock: SimulatedClock,
    show: Callable[[], None],
    paced: bool = False,
    physics: Callable[[float], None] | None = None,
) -> None:
    """Fly to the end on a simulated clock: the same setpoints each time, bit for bit.

    Args:
        flight: fresh.
        clock: stands at 0.
        show: is called ten times a simulated second.
        paced: go no faster than a real clock does, for users who watch.
        physics: brings what flies to a time; None is the flight's own autopilot.
    """
    lockstep = Lockstep(clock)

    if physics is None and flight.autopilot is not None:
        physics = flight.autopilot.step
    if physics is None:
        raise ValueError("an external autopilot has its own time: it flies in real time alone")
    fly_to = physics

    def capture() -> None:
        delivery = flight.camera.capture()
        if delivery is not None:
            lockstep.at(delivery.available_s, lambda: see(delivery.exposure))
        # One physics step later the vehicle's place at the time of exposure is known.
        lockstep.at(flight.camera.next_capture_s + STEP_S, capture)

    def see(exposure: Exposure) -> None:
        if not flight.vision.is_free:
            return
        frame = exposure.frame if flight.vision.needs_picture else exposure.unseen
        record = flight.vision.step(frame, VISION_DELAY_S)
        lockstep.at(record.done_s, lambda: flight.vision.tracks.put(record))

    lockstep.every(STEP_S, lambda: fly_to(clock.now()))
    lockstep.at(flight.camera.next_capture_s + STEP_S, capture)
    lockstep.every(1 / flight.settings.control_rate_hz, lambda: flight.control.step(clock.now()))
    lockstep.every(SHOW_EVERY_S, show)
    if paced:
        lockstep.every(PACE_S, Pacer(clock).wait)
    with few_collections():
        lockstep.run(lambda: flight.finished)


def fly_realtime(flight: SimulatedFlight, clock: Clock, show: Callable[[], None]) -> None:
    """Fly to the end in real time, with a thread each for autopilot, camera, vision, control."""

    def watch() -> bool:
        show()
        flight.check_answered()
        return not flight.finished

    autopilot = flight.autopilot
    flown = nullcontext() if autopilot is None else autopilot_thread(autopilot, clock)
    with CameraSource(flight.camera, clock) as source, flown:
        rate_hz = flight.settings.control_rate_hz
        RealtimeRun(clock, source, flight.vision, flight.control, rate_hz).run(watch, SHOW_EVERY_S)


class CameraSource(ClosesItself):
    """The simulated camera as a frame source that waits for its frames."""

    def __init__(self, camera: SimCamera, clock: Clock) -> None:
        self._camera = camera
        self._clock = clock
        self._closed = False
        self.nominal_rate_hz = camera.rate_hz
        self.frame_count: int | None = None
        self.problem: str | None = None

    def read(self) -> Frame | None:
        """Return the next frame when it arrives, None after closing."""
        while not self._closed:
            frame = self._camera.read(self._clock)
            if frame is not None:
                return frame
        return None

    def close(self) -> None:
        """End the reading."""
        self._closed = True
