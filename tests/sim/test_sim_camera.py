"""The simulated camera: its timing, its imperfections, its faults."""

from collections.abc import Callable

import numpy as np
import pytest

from follower_sim.camera import Delivery, Sensor, SimCamera
from follower_sim.kinematics import BodyState
from follower_sim.scenario.scenario import SimCameraSettings
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock

SMALL = {"width": 64, "height": 48}


def hover(time_s: float) -> BodyState:
    return BodyState(time_s, (0.0, 0.0, -6.0))


class Blank:
    """Stands in for the renderer: a grey picture."""

    def render(self, time_s: float, body: BodyState, exposure_s: float) -> np.ndarray:
        assert exposure_s >= 0
        assert body.time_s == pytest.approx(time_s + 100)
        return np.full((48, 64, 3), 100, np.uint8)


def camera(make_world: Callable[..., World], **settings: object) -> SimCamera:
    world = make_world(camera={**SMALL, **settings})
    return SimCamera(world, hover, start_s=100.0, render=Blank().render)


def taken(source: SimCamera, count: int) -> list[Delivery | None]:
    return [source.capture() for _ in range(count)]


def test_pictures_come_at_the_rate_and_late(make_world: Callable[..., World]) -> None:
    source = camera(make_world, rate_hz=20, latency_s=0.07, latency_jitter_s=0.0, jitter_s=0.0)
    assert source.rate_hz == 20
    for number, delivery in enumerate(taken(source, 10)):
        assert delivery.frame.sequence == number
        assert delivery.frame.captured_s == pytest.approx(100 + number / 20)
        assert delivery.available_s - delivery.frame.captured_s == pytest.approx(0.07)


def test_jitter_moves_pictures_about_an_even_schedule(make_world: Callable[..., World]) -> None:
    source = camera(make_world, rate_hz=30, jitter_s=0.004, drop_probability=0.0)
    stamps = [d.frame.captured_s for d in taken(source, 600) if d is not None]
    late = np.array(stamps) - (100 + np.arange(600) / 30)
    assert np.std(late) == pytest.approx(0.004, rel=0.15)
    assert abs(np.mean(late)) < 0.001
    assert (np.diff(stamps) > 0).all()


def test_latency_only_ever_adds(make_world: Callable[..., World]) -> None:
    source = camera(make_world, latency_s=0.05, latency_jitter_s=0.01)
    late = [d.available_s - d.frame.captured_s for d in taken(source, 300) if d is not None]
    assert min(late) >= 0.05 - 1e-9
    assert 0.052 < np.mean(late) < 0.065


def test_dropped_pictures_leave_gaps_in_the_numbers(make_world: Callable[..., World]) -> None:
    source = camera(make_world, drop_probability=0.2)
    deliveries = taken(source, 1000)
    assert sum(d is None for d in deliveries) == pytest.approx(200, abs=50)
    assert all(d is None or d.frame.sequence == n for n, d in enumerate(deliveries))


def test_the_stamp_offset_moves_the_stamp_alone(make_world: Callable[..., World]) -> None:
    plain, shifted = (camera(make_world, stamp_offset_s=offset).capture() for offset in (0.0, 0.03))
    assert shifted.frame.captured_s == pytest.approx(plain.frame.captured_s + 0.03)
    assert shifted.available_s == plain.available_s


def test_the_same_seed_takes_the_same_pictures(make_world: Callable[..., World]) -> None:
    first, second = (taken(camera(make_world, drop_probability=0.1), 30) for _ in range(2))
    for a, b in zip(first, second, strict=True):
        assert (a is None) == (b is None)
        if a is not None and b is not None:
            assert a.available_s == b.available_s
            assert np.array_equal(a.frame.image, b.frame.image)


def test_reading_waits_for_the_delivery_and_skips_what_was_missed(
    make_world: Callable[..., World],
) -> None:
    source = camera(make_world, rate_hz=10, latency_s=0.05, latency_jitter_s=0.0, jitter_s=0.0)
    clock = SimulatedClock(100.0)
    frame = source.read(clock)
    assert frame is not None
    assert clock.now() == pytest.approx(100.05)
    clock.sleep_until(102.02)
    late = source.read(clock)
    assert 101.9 <= late.captured_s <= 102.1
    assert late.sequence == round((late.captured_s - 100) * 10)


def test_pictures_that_are_under_way_for_long_still_come_at_their_rate(
    make_world: Callable[..., World],
) -> None:
    source = camera(make_world, rate_hz=10, latency_s=0.27, latency_jitter_s=0.0, jitter_s=0.0)
    clock = SimulatedClock(100.0)
    for number in range(20):
        frame = source.read(clock)
        assert frame.sequence == number
        assert clock.now() == pytest.approx(100.27 + 0.1 * number)
        assert frame.captured_s == pytest.approx(100.0 + 0.1 * number)


def faulty(make_world: Callable[..., World], kind: str) -> SimCamera:
    world = make_world(
        camera={**SMALL, "jitter_s": 0.0, "rate_hz": 10},
        faults=[{"kind": kind, "from_s": 0.45, "until_s": 0.95}],
    )
    return SimCamera(world, hover, start_s=100.0, render=Blank().render)


def test_a_black_camera_shows_only_noise(make_world: Callable[..., World]) -> None:
    images = [d.frame.image for d in taken(faulty(make_world, "black"), 12) if d is not None]
    assert [image.mean() > 50 for image in images] == [True] * 5 + [False] * 5 + [True] * 2


def test_a_frozen_camera_repeats_itself_with_new_stamps(make_world: Callable[..., World]) -> None:
    frames = [d.frame for d in taken(faulty(make_world, "frozen"), 12) if d is not None]
    assert all(np.array_equal(frames[n].image, frames[4].image) for n in range(5, 10))
    assert not np.array_equal(frames[10].image, frames[4].image)
    assert (np.diff([f.captured_s for f in frames]) > 0).all()


def test_a_silent_camera_delivers_nothing(make_world: Callable[..., World]) -> None:
    deliveries = taken(faulty(make_world, "silent"), 12)
    assert [d is None for d in deliveries] == [False] * 5 + [True] * 5 + [False] * 2


def test_a_removed_target_is_no_longer_drawn(make_world: Callable[..., World]) -> None:
    world = make_world(faults=[{"kind": "target_removed", "from_s": 0.5}])
    source = SimCamera(world, hover)
    first = source.capture()
    source.next_capture_s = 0.6
    second = source.capture()
    reds = [
        ((image[..., 2] > 120) & (image[..., 1] < 80)).sum()
        for image in (first.frame.image, second.frame.image)
    ]
    assert reds[0] > 100
    assert reds[1] == 0


def test_when_a_picture_is_drawn_and_which_ones_are_makes_no_difference(
    make_world: Callable[..., World],
) -> None:
    faults = [
        {"kind": "shaken", "from_s": 0.1, "until_s": 0.3},
        {"kind": "frozen", "from_s": 0.35, "until_s": 0.45},
    ]
    world = make_world(camera={"drop_probability": 0.0}, faults=faults)
    at_once = [d.frame.image for d in taken(SimCamera(world, hover, seed=3), 12) if d is not None]
    late = [d for d in taken(SimCamera(world, hover, seed=3), 12) if d is not None]
    assert len(late) == 12
    for number in (11, 4, 8):
        assert np.array_equal(late[number].frame.image, at_once[number])


def test_a_picture_that_nobody_looked_at_has_its_times_and_its_size(
    make_world: Callable[..., World],
) -> None:
    delivery = SimCamera(make_world(camera={"drop_probability": 0.0}), hover).capture()
    seen, unseen = delivery.frame, delivery.exposure.unseen
    assert (unseen.captured_s, unseen.sequence) == (seen.captured_s, seen.sequence)
    assert unseen.image.shape == seen.image.shape
    assert not unseen.image.any()


def test_noise_has_the_strength_asked_for_and_no_bias() -> None:
    settings = SimCameraSettings(noise=4, vignetting=0, exposure_drift=0)
    sensor = Sensor(settings, np.random.default_rng(1))
    flat = np.full((480, 640, 3), 128, np.uint8)
    first, second = (sensor.expose(flat, 0, sensor.grain()).astype(float) for _ in range(2))
    assert first.std() == pytest.approx(4, rel=0.03)
    assert first.mean() == pytest.approx(128, abs=0.1)
    assert np.corrcoef(first.ravel(), second.ravel())[0, 1] < 0.05


def test_vignetting_darkens_the_corners_alone() -> None:
    settings = SimCameraSettings(noise=0, vignetting=0.4, exposure_drift=0)
    image = Sensor(settings, np.random.default_rng(1)).expose(
        np.full((480, 640, 3), 200, np.uint8), 0, (0, 0)
    )
    assert image[240, 320, 0] == 200
    assert image[0, 0, 0] == pytest.approx(200 * 0.6, abs=2)


def test_the_exposure_drifts_within_its_amplitude() -> None:
    sensor = Sensor(SimCameraSettings(exposure_drift=0.1), np.random.default_rng(1))
    gains = [sensor.gain(t) for t in np.arange(0, 120, 0.1)]
    assert 0.9 <= min(gains) < 0.96
    assert 1.04 < max(gains) <= 1.1
    assert np.abs(np.diff(gains)).max() < 0.02
