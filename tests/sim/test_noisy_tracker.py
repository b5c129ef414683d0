"""The stand-in for vision: as sure, as late and as wrong as its settings say."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from follower_control.common.strict_config import SettingsError
from follower_sim.camera import BlindCamera, SimCamera
from follower_sim.kinematics import BodyState
from follower_sim.noisy_tracker import PRODUCER, NoisyTracker
from follower_sim.scenario.scenario import NoisyTrackerSettings, Scenario
from follower_sim.scenario.scenario_file import overridden
from follower_sim.world.silhouettes import SeenBody
from follower_sim.world.world import World
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.trackers.track import TrackState

BOX = Box(320, 240, 60, 40)
SIDE = math.sqrt(60 * 40)
QUIET = NoisyTrackerSettings(centre_noise=0, size_noise=0, false_share=0, recognise_s=0)
PERIOD_S = 1 / 30


def truth(visible: float = 1.0, in_frame: float = 1.0, box: Box | None = BOX) -> SeenBody:
    return SeenBody(box, in_frame, visible)


def stand_in(
    settings: NoisyTrackerSettings, truth_at: Callable[[float], SeenBody], seed: int = 0
) -> NoisyTracker:
    return NoisyTracker(truth_at, (640, 480), settings, np.random.default_rng(seed))


def frame(number: int) -> Frame:
    return Frame(np.zeros((48, 64, 3), np.uint8), number * PERIOD_S, number)


def states(
    settings: NoisyTrackerSettings, hidden: range, count: int, seed: int = 0
) -> list[TrackState]:
    """Return the states of `count` frames of which some are hidden."""

    def truth_at(stamp_s: float) -> SeenBody:
        return truth(0.0 if round(stamp_s / PERIOD_S) in hidden else 1.0)

    sight = stand_in(settings, truth_at, seed)
    sight.start(frame(0), BOX)
    return [sight.step(frame(number)).state for number in range(1, count)]


def test_without_noise_it_gives_the_true_box_and_says_who_it_is() -> None:
    sight = stand_in(QUIET, lambda _: truth())
    assert sight.select(frame(0)) == BOX
    sight.start(frame(0), BOX)
    track = sight.step(frame(1))
    assert (track.box, track.state, track.produced_by) == (BOX, TrackState.TRACKING, PRODUCER)
    assert (track.captured_s, track.sequence) == (PERIOD_S, 1)


def test_its_noise_has_the_spread_and_the_slowness_that_were_asked_for() -> None:
    settings = NoisyTrackerSettings(centre_noise=0.05, size_noise=0.1, noise_s=0.3, false_share=0)
    sight = stand_in(settings, lambda _: truth())
    sight.start(frame(0), BOX)
    boxes = [sight.step(frame(number)).box for number in range(1, 12_000)]
    across = np.array([box.cx - BOX.cx for box in boxes]) / SIDE
    sizes = np.log([math.sqrt(box.width * box.height) / SIDE for box in boxes])
    assert across.mean() == pytest.approx(0, abs=0.01)
    assert across.std() == pytest.approx(0.05, rel=0.1)
    assert sizes.std() == pytest.approx(0.1, rel=0.1)
    neighbours = np.corrcoef(across[:-1], across[1:])[0, 1]
    assert neighbours == pytest.approx(math.exp(-PERIOD_S / 0.3), abs=0.02)


def test_offset_and_size_factor_last() -> None:
    settings = NoisyTrackerSettings(
        centre_noise=0, size_noise=0, offset=(0.1, -0.2), size_factor=0.5, false_share=0
    )
    box = stand_in(settings, lambda _: truth()).select(frame(0))
    assert (box.cx - BOX.cx, box.cy - BOX.cy) == pytest.approx((0.1 * SIDE, -0.2 * SIDE))
    assert (box.width, box.height) == pytest.approx((30, 20))


@pytest.mark.parametrize(
    "unseen", [truth(visible=0.3), truth(in_frame=0.3), truth(box=None, in_frame=0)]
)
def test_a_hidden_target_or_one_outside_of_the_frame_is_neither_selected_nor_seen(
    unseen: SeenBody,
) -> None:
    sight = stand_in(QUIET, lambda _: unseen)
    assert sight.select(frame(0)) is None
    sight.start(frame(0), BOX)
    assert sight.step(frame(1)).state is TrackState.COASTING


def test_a_hidden_target_is_coasted_after_then_lost_then_found_again() -> None:
    seen = states(QUIET, range(10, 40), 60)
    assert set(seen[:9]) == {TrackState.TRACKING}
    coasts = round(QUIET.coast_s / PERIOD_S)
    assert set(seen[9 : 9 + coasts]) == {TrackState.COASTING}
    assert set(seen[10 + coasts : 39]) == {TrackState.LOST}
    assert set(seen[39:]) == {TrackState.TRACKING}


def test_recognising_takes_as_long_on_average_as_was_asked() -> None:
    settings = NoisyTrackerSettings(false_share=0, recognise_s=0.5)
    takes = []
    for seed in range(150):
        seen = states(settings, range(5, 25), 200, seed)
        takes.append((seen.index(TrackState.TRACKING, 24) - 24) * PERIOD_S)
    assert np.mean(takes) == pytest.approx(0.5, rel=0.25)


def test_something_else_is_taken_for_the_target_as_often_as_was_asked() -> None:
    settings = NoisyTrackerSettings(false_share=0.5, false_after_s=0.2, false_s=0.3)
    mistaken = [
        TrackState.TRACKING in states(settings, range(5, 200), 190, seed)[5:] for seed in range(120)
    ]
    assert np.mean(mistaken) == pytest.approx(0.5, abs=0.13)
    assert TrackState.TRACKING not in states(QUIET, range(5, 200), 190)[5:]


def test_the_same_seed_sees_the_same() -> None:
    def boxes(seed: int) -> list[Box]:
        sight = stand_in(NoisyTrackerSettings(), lambda _: truth(), seed)
        sight.start(frame(0), BOX)
        return [sight.step(frame(number)).box for number in range(1, 20)]

    assert boxes(3) == boxes(3) != boxes(4)


def test_it_has_to_be_started() -> None:
    with pytest.raises(RuntimeError, match="not started"):
        stand_in(QUIET, lambda _: truth()).step(frame(0))


def test_the_blind_camera_has_the_times_of_the_seeing_one() -> None:
    scenario = Scenario.model_validate(
        {
            "name": "small",
            "title": "A person stands.",
            "duration_s": 10,
            "targets": [
                {"kind": "person", "colour": "#d0202c", "path": {"points": [[9, 0], [10, 0]]}}
            ],
            "camera": {"width": 64, "height": 48, "drop_probability": 0.2},
            "start": {"at": [0, 0]},
            "select": {"colour": "#d0202c"},
        }
    )
    world, body = World(scenario), BodyState(0.0, (0.0, 0.0, -4.0))

    def times(camera: SimCamera) -> list[tuple[float, int, float] | None]:
        taken = [camera.capture() for _ in range(25)]
        return [
            one and (one.frame.captured_s, one.frame.sequence, one.available_s) for one in taken
        ]

    blind = BlindCamera(world, lambda _: body)
    delivery = blind.capture()
    assert delivery.frame.image.shape == (48, 64, 3)
    assert not delivery.frame.image.any()
    assert times(BlindCamera(world, lambda _: body)) == times(SimCamera(world, lambda _: body))


def test_overrides_reach_into_sections_and_lists() -> None:
    data = {"wind": {"mean_m_s": 1}, "targets": [{"kind": "car"}, {"kind": "car"}]}
    changes = ("wind.mean_m_s=6", "targets.1.kind=boat", "camera.rate_hz=60")
    result = overridden(data, changes, "--scene")
    assert result == {
        "wind": {"mean_m_s": 6},
        "targets": [{"kind": "car"}, {"kind": "boat"}],
        "camera": {"rate_hz": 60},
    }
    assert data["wind"] == {"mean_m_s": 1}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("wind", "--scene wind: write key=value"),
        ("targets.2.kind=car", "'2' is no number from 0 to 0"),
        ("targets.first.kind=car", "'first' is no number from 0 to 0"),
        ("name.first=x", "there is no section to hold 'first'"),
        ("wind=[", "no valid YAML"),
    ],
)
def test_an_override_that_leads_nowhere_is_named(text: str, message: str) -> None:
    with pytest.raises(SettingsError) as caught:
        overridden({"name": "a", "targets": [{}]}, (text,), "--scene")
    assert message in str(caught.value)
