"""Whether the control loop keeps its 50 Hz while vision saturates a core.

    python benchmarks/control_jitter.py [SECONDS]

The threads are those of a flight, as `follower bench` runs them: capture, vision, control, the
recorder's, and a simulated autopilot reached by UDP. Vision runs the correlation tracker on
1280x720 frames that are decoded beforehand and never run out, so that it never rests. Measured is
how late each control step begins, and how far the time between two steps is from 20 ms; the first
half second is left out.
"""

import tempfile
from pathlib import Path

import command_line
import cv2

from follower.apps.bench.measure import measure
from follower.apps.bench.result import BenchSetup
from follower.apps.bench.scene import BenchCamera, BenchClip, render_clips
from follower_vision.clock import Clock
from follower_vision.images.frame import Image

SIZE = 1280, 720


class FastCamera(BenchCamera):
    """Has all pictures decoded, so that capture costs nothing."""

    def __init__(self, clip: BenchClip, clock: Clock, rate_hz: float | None = None) -> None:
        self._images = [clip.decoded(index) for index in range(len(clip.pictures))]
        super().__init__(clip, clock, rate_hz)

    def picture(self, index: int) -> Image:
        """Return one of them."""
        return self._images[index]


def main() -> None:
    """Measure and print."""
    parser = command_line.parser(__doc__)
    parser.add_argument("seconds", nargs="?", type=command_line.positive, default=20.0)
    seconds: float = parser.parse_args().seconds
    cv2.setNumThreads(1)
    clips = render_clips((SIZE,), 40)
    assert clips is not None
    setup = BenchSetup(tracker="correlation", width=SIZE[0], height=SIZE[1], video=False)
    with tempfile.TemporaryDirectory() as folder:
        row = measure(setup, clips[SIZE], seconds, Path(folder), camera_type=FastCamera)
    assert row is not None
    print(f"{row.rate_hz:.0f} frames a second tracked, {row.step_ms:.1f} ms each (median)")
    print(f"{'ms':26}{'median':>9}{'p99':>9}{'max':>9}")
    begins = f"{row.late_ms:9.3f}{row.late_p99_ms:9.3f}{row.late_max_ms:9.3f}"
    print(f"{'step begins late by':26}{begins}")
    print(f"{'period off 20 ms by':26}{'':9}{row.period_off_p99_ms:9.3f}")
    print(f"{'step takes':26}{row.control_ms:9.3f}")


if __name__ == "__main__":
    command_line.run(main)
