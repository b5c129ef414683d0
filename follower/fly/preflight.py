"""`follower preflight`: the checklist, alone."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager

import cv2
import typer
from rich.console import Console

from follower.fly.camera import open_camera_or_dead
from follower.fly.options import FlyOptions
from follower.links.connection import open_connection
from follower.links.link import Link
from follower.links.opening import open_link
from follower.preflight.camera_watch import CameraWatch
from follower.preflight.check import Result
from follower.preflight.observing import Observation, Surroundings
from follower.preflight.running import check_names
from follower.preflight.showing import LiveChecklist, print_checklist, to_json
from follower.recorder import epoch_now_ns
from follower.settings import Settings
from follower_vision.clock import Clock, MonotonicClock

_READY, _NOT_READY = 0, 1


def preflight(options: FlyOptions, as_json: bool = False) -> int:
    """Check everything, show the list, and return the exit code: 0 only if nothing refuses.

    Raises:
        ValueError, OSError: what the user can mend, in one line.
    """
    skip = check_names(options.skip)
    settings = options.settings()
    about = Surroundings(settings, options.out, options.lens_given)
    console = Console()
    clock = MonotonicClock()
    cv2.setNumThreads(1)
    with (
        opened_link(options, settings, clock) as link,
        open_camera_or_dead(options, clock) as source,
        CameraWatch(source, options.shown_camera, clock) as camera,
        LiveChecklist(console) as live,
    ):
        observation = Observation(link, camera, clock, about)
        results = observation.run(skip, _nobody if as_json else live.show, options.look_s)
        snapshot = observation.snapshot(clock.now())
    if as_json:
        typer.echo(to_json(results, snapshot))
    else:
        print_checklist(console, results)
    return _NOT_READY if any(result.refuses for result in results) else _READY


def _nobody(_results: list[Result]) -> None:
    """Show nothing."""


@contextmanager
def opened_link(options: FlyOptions, settings: Settings, clock: Clock) -> Iterator[Link]:
    """Give a link to the autopilot that sends no setpoint by itself.

    Raises:
        ConnectionFailedError: it cannot be opened.
    """
    with (
        closing(open_connection(options.connect)) as transport,
        closing(open_link(transport, settings.link, clock, epoch_now_ns(clock))) as link,
    ):
        yield link
