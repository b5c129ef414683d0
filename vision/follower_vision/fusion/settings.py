"""Settings of Fusion."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

from follower_vision.blur import BlurSettings
from follower_vision.reidentify import ReidentifySettings


@dataclass(frozen=True, slots=True)
class FusionSettings:
    """How the motion tracker and the detector work together.

    The first group are the improvements over the paper; each can be switched off.

    Attributes:
        zoomed_validation: validate on a zoomed crop about the target, not on the whole image.
        class_lock: accept detections of the classes alone that overlap the target at the start.
        learn_box_ratio: learn how the target's box differs from the detector's.
        camera_motion: carry the expected place along with the background.
        score_coasting: coast from the second frame in which the motion tracker is unsure, and
            then be lost.
        size_clamp: keep the box's size near the last confirmed one.
        distractor_memory: follow look-alikes as well, and decide identity among all of them.
        appearance_check: ask re-identification when a track is doubtful.
        growing_search: search a growing region first after a loss, the whole image in between,
            look closer at what may be the target, and later at one small region after the other.
        keep_template: correct the motion tracker without teaching it anew at each validation.
        prospects: take nothing for the target where, by what is known of its way through the
            world, it cannot be; a lost one is expected where that says.
        validate_every: frames between two validations.
        validate_steady_every: the same while the motion tracker is certain, the detector has
            agreed with it lately, and nobody like the target is about.
        validate_blurred_every: the same while the target is blurred; 1 is the paper.
        search_every: frames between two searches while the target is lost.
        crop_sizes: side of the validated crop in target sizes.
        crop_least_px: the crop's smallest side. (With prospects, where somebody like the target is
            about, every second crop is 0.6 times as wide as these two say.)
        match_iou: least overlap of a detection that validates the track.
        misses_to_lose: so many validations in a row without the target make it lost, if its looks
            do not speak for it.
        low_ratio: a motion tracker's confidence below this share of its usual one is low.
        resume_ratio: it has to come back to this share after coasting.
        low_frames: the frame with a low confidence from which the track coasts.
        coast_s: how long the track may coast before it is lost.
        size_least: smallest size relative to the confirmed one.
        size_most: largest size relative to the confirmed one.
        position_share: how far a validated box moves towards the detection, 0 to 1.
        size_share: the same for its size.
        vote_looks: detections after which a target is taken as unfamiliar if no class fits.
        doubt_ratio: a re-identification score below this share of the usual one is doubt.
        doubt_ratio_sure: the same while the motion tracker is quite certain.
        insist_s: a confident motion tracker that keeps its place for so long is believed though
            the target looks different.
        doubt_s: how long a confident motion tracker may insist while in doubt; after that it is
            followed as well, but believed only if its box looks like the target again.
        doubt_score: a re-identification score (0 to 2) below this speaks against the track.
        search_growth_s: by how many target sizes the searched region grows in a second.
        size_change_found: largest ratio between the sizes before a loss and when found again.
        reidentify: templates and the threshold epsilon.
        blur: when the neighbourhood counts as blurred.
    """

    zoomed_validation: bool = True
    class_lock: bool = True
    learn_box_ratio: bool = True
    camera_motion: bool = True
    score_coasting: bool = True
    size_clamp: bool = True
    distractor_memory: bool = True
    appearance_check: bool = True
    growing_search: bool = True
    keep_template: bool = True
    prospects: bool = True

    validate_every: int = 4
    validate_steady_every: int = 8
    validate_blurred_every: int = 2
    search_every: int = 2
    crop_sizes: float = 5.0
    crop_least_px: float = 128.0
    match_iou: float = 0.3
    misses_to_lose: int = 5
    low_ratio: float = 0.8
    resume_ratio: float = 0.9
    low_frames: int = 2
    coast_s: float = 0.4
    size_least: float = 0.75
    size_most: float = 1.35
    position_share: float = 0.5
    size_share: float = 0.5
    vote_looks: int = 10
    doubt_ratio: float = 0.72
    doubt_ratio_sure: float = 0.6
    insist_s: float = 0.5
    doubt_s: float = 1.0
    doubt_score: float = 0.8
    search_growth_s: float = 8.0
    size_change_found: float = 2.0
    reidentify: ReidentifySettings = field(default_factory=ReidentifySettings)
    blur: BlurSettings = field(default_factory=BlurSettings)

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    def __post_init__(self) -> None:
        pauses = ("validate_every", "validate_steady_every", "validate_blurred_every")
        for name in (*pauses, "search_every", "misses_to_lose", "low_frames"):
            if getattr(self, name) < 1:
                raise ValueError(f"fusion: {name} is at least 1")
        for name in ("match_iou", "position_share", "size_share", "low_ratio", "resume_ratio"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"fusion: {name} lies between 0 and 1")
        for name in ("crop_sizes", "crop_least_px", "coast_s", "search_growth_s"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"fusion: {name} has to be positive")
        if not 0 < self.size_least <= 1 <= self.size_most < math.inf:
            raise ValueError("fusion: size_least <= 1 <= size_most has to hold")
        if self.size_change_found < 1:
            raise ValueError("fusion: size_change_found is at least 1")

    @classmethod
    def paper(cls) -> FusionSettings:
        """Return the paper's algorithm, its slips corrected, without any improvement."""
        settings = cls(validate_every=10, validate_steady_every=10, validate_blurred_every=1)
        for name in IMPROVEMENTS:
            settings = settings.without(name)
        return settings.without_recent()

    def without(self, improvement: str) -> FusionSettings:
        """Return the same with one improvement switched off.

        Raises:
            ValueError: there is no such improvement.
        """
        if improvement not in IMPROVEMENTS:
            raise ValueError(f"fusion: no improvement {improvement!r}: {', '.join(IMPROVEMENTS)}")
        changes: dict[str, Any] = {improvement: False}
        return replace(self, **changes)

    def without_recent(self) -> FusionSettings:
        """Return the same with the first second's templates alone, as in the paper."""
        return replace(self, reidentify=replace(self.reidentify, max_recent=0))


IMPROVEMENTS = (
    "zoomed_validation",
    "class_lock",
    "learn_box_ratio",
    "camera_motion",
    "score_coasting",
    "size_clamp",
    "distractor_memory",
    "appearance_check",
    "growing_search",
    "keep_template",
    "prospects",
)
"""The names of the switches."""
