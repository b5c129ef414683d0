"""A simulated tracker: the truth with noise, for studies of control that need no pixels.

It stands on the simulator's side of the house. What steers gets `Track`s as from any tracker, at
the camera's times, with the camera's latency, jitter and lost frames.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from follower_sim.scenario.scenario import NoisyTrackerSettings
from follower_sim.world.silhouettes import SeenBody
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.trackers.track import Track, TrackState

PRODUCER = "truth+noise"
LABEL = "no pixels: vision from truth + noise"
_FALSE_CONFIDENCE, _COASTING_CONFIDENCE = 0.6, 0.2


class NoisyTracker:
    """Answers for frames as a target tracker does, without a look at them.

    Args:
        truth_at: where the target truly is in a frame with this capture stamp.
        size: width and height of the frames.
        settings: how well it sees.
        rng: source of randomness.
    """

    def __init__(
        self,
        truth_at: Callable[[float], SeenBody],
        size: tuple[int, int],
        settings: NoisyTrackerSettings,
        rng: np.random.Generator,
    ) -> None:
        self._truth_at = truth_at
        self._size = size
        self._settings = settings
        self._rng = rng
        self._errors = rng.normal(0.0, 1.0, 3)
        self._errors_s = -math.inf
        self._loss: _Loss | None = None
        self._box: Box | None = None

    def select(self, frame: Frame) -> Box | None:
        """Return the target's box as soon as it is in view: what the operator points out."""
        return self._seen(frame.captured_s)

    def start(self, frame: Frame, box: Box) -> Track:
        """Follow the target; it is the true one, wherever `box` is."""
        self._loss, self._box = None, box
        return _track(frame, box, TrackState.TRACKING, 1.0)

    def step(self, frame: Frame) -> Track:
        """Return the target's track in the next frame.

        Raises:
            RuntimeError: `start` was not called.
        """
        if self._box is None:
            raise RuntimeError("the simulated tracker was not started")
        now_s, seen = frame.captured_s, self._seen(frame.captured_s)
        if self._loss is None and seen is None:
            self._loss = _Loss.drawn(now_s, self._settings, self._size, self._rng)
        if self._loss is not None:
            self._loss.note(now_s, seen is not None)
            if self._loss.is_mistaken(now_s, self._settings):
                mistake = self._loss.mistake
                return _track(frame, mistake, TrackState.TRACKING, _FALSE_CONFIDENCE)
        if seen is not None and self._knows(now_s):
            self._loss, self._box = None, seen
            return _track(frame, seen, TrackState.TRACKING, 1.0)
        if self._is_coasting(now_s):
            return _track(frame, self._box, TrackState.COASTING, _COASTING_CONFIDENCE)
        return _track(frame, self._box, TrackState.LOST, 0.0)

    def _knows(self, now_s: float) -> bool:
        """Whether what is in view is known to be the target."""
        return self._loss is None or self._is_coasting(now_s) or self._loss.is_recognised(now_s)

    def _is_coasting(self, now_s: float) -> bool:
        return self._loss is not None and now_s - self._loss.since_s < self._settings.coast_s

    def _seen(self, stamp_s: float) -> Box | None:
        """Return the target's box as it is seen, None if it is not."""
        truth = self._truth_at(stamp_s)
        self._drift(stamp_s)
        visible = truth.in_frame_share * truth.visible_share
        if truth.box is None or visible <= 0 or visible < self._settings.least_visible:
            return None
        return self._disturbed(truth.box)

    def _drift(self, stamp_s: float) -> None:
        """Let the errors change with the time that has passed."""
        elapsed_s = max(0.0, stamp_s - self._errors_s)
        noise_s = self._settings.noise_s
        kept = math.exp(-elapsed_s / noise_s) if noise_s > 0 else 0.0
        fresh = self._rng.normal(0.0, 1.0, 3)
        self._errors = kept * self._errors + math.sqrt(1 - kept * kept) * fresh
        self._errors_s = stamp_s

    def _disturbed(self, box: Box) -> Box:
        s, side = self._settings, math.sqrt(box.width * box.height)
        right, down, scale = (float(error) for error in self._errors)
        factor = s.size_factor * math.exp(s.size_noise * scale)
        return Box(
            box.cx + side * (s.offset[0] + s.centre_noise * right),
            box.cy + side * (s.offset[1] + s.centre_noise * down),
            box.width * factor,
            box.height * factor,
        )


@dataclass(slots=True)
class _Loss:
    """What becomes of one loss, drawn when it begins."""

    since_s: float
    takes_s: float
    mistake: Box
    mistaken_s: float
    back_s: float | None = None

    @classmethod
    def drawn(
        cls,
        now_s: float,
        settings: NoisyTrackerSettings,
        size: tuple[int, int],
        rng: np.random.Generator,
    ) -> _Loss:
        takes_s = float(rng.exponential(settings.recognise_s))
        is_mistaken = rng.uniform() < settings.false_share
        mistaken_s = now_s + settings.coast_s + float(rng.exponential(settings.false_after_s))
        x, y = rng.uniform(0.1, 0.9, 2) * size
        side = float(rng.uniform(0.04, 0.12)) * size[0]
        mistake = Box(float(x), float(y), side, side)
        return cls(now_s, takes_s, mistake, mistaken_s if is_mistaken else math.inf)

    def note(self, now_s: float, seen: bool) -> None:
        """Note since when the target is in view again."""
        if not seen:
            self.back_s = None
        elif self.back_s is None:
            self.back_s = now_s

    def is_mistaken(self, now_s: float, settings: NoisyTrackerSettings) -> bool:
        return self.mistaken_s <= now_s < self.mistaken_s + settings.false_s

    def is_recognised(self, now_s: float) -> bool:
        return self.back_s is not None and now_s - self.back_s >= self.takes_s


def _track(frame: Frame, box: Box, state: TrackState, confidence: float) -> Track:
    return Track(box, state, confidence, PRODUCER, frame.captured_s, frame.sequence)
