"""Weather, light and lens in the pictures: what each does, that it repeats, and that off is off."""

import math
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from follower_control.common.strict_config import SettingsError, parse
from follower_sim.camera import SimCamera
from follower_sim.imperfections import LensDirt, LowLight, RollingShutter
from follower_sim.kinematics import BodyState
from follower_sim.scenario.scenario import Scenario, SimCameraSettings
from follower_sim.scenario.weather import LowLightSettings
from follower_sim.view import CameraView
from follower_sim.world.render import Renderer
from follower_sim.world.weather import AIR_LIGHT, Rain
from follower_sim.world.world import World
from follower_vision.geometry.camera_model import CameraModel, Vector
from follower_vision.geometry.line_of_sight import CameraMount
from follower_vision.images.frame import Image

MakeWorld = Callable[..., World]
HOVER = BodyState(0, (0.0, 0.0, -6.0))
SMALL = {"width": 320, "height": 240, "exposure_s": 0.004, "drop_probability": 0.0}
EFFECTS = {
    "low light": {"camera": {"low_light": {"stops": 6}}},
    "rain": {"weather": {"rain_mm_h": 60}},
    "fog": {"weather": {"fog_per_m": 0.05}},
    "lens dirt": {"camera": {"lens_dirt": 0.2}},
    "rolling shutter": {"camera": {"row_time_s": 1e-4}},
    "motion blur": {"camera": {"exposure_s": 0.03}},
}


def turning(time_s: float) -> BodyState:
    return replace(HOVER, time_s=time_s, rates_rad_s=(0.2, 0.1, 0.9))


def frames(make_world: MakeWorld, **changes: dict[str, object]) -> Image:
    """Take the first three pictures of the small world; changes of its camera are merged in."""
    camera = {**SMALL, **changes.pop("camera", {})}
    source = SimCamera(make_world(camera=camera, **changes), turning)
    deliveries = [source.capture() for _ in range(3)]
    return np.stack([one.frame.image for one in deliveries if one is not None])


@pytest.mark.slow
def test_with_all_strengths_at_nought_each_picture_is_what_it_is_without_them(
    make_world: MakeWorld,
) -> None:
    off = {"low_light": {"stops": 0}, "lens_dirt": 0, "row_time_s": 0}
    weather = {"fog_per_m": 0, "rain_mm_h": 0}
    plain = frames(make_world)
    assert np.array_equal(plain, frames(make_world, camera=off, weather=weather))
    assert not np.array_equal(plain, frames(make_world, camera={"lens_dirt": 0.01}))


@pytest.mark.slow
@pytest.mark.parametrize("effect", EFFECTS)
def test_an_effect_repeats_with_its_seed_and_leaves_the_timing_alone(
    make_world: MakeWorld, effect: str
) -> None:
    changes = EFFECTS[effect]
    first, again = (frames(make_world, **changes) for _ in range(2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, frames(make_world))
    camera, weather = {**SMALL, **changes.get("camera", {})}, changes.get("weather", {})
    worlds = make_world(camera=SMALL), make_world(camera=camera, weather=weather)
    sources = [SimCamera(world, turning) for world in worlds]
    plain, spoiled = ([one.capture() for _ in range(20)] for one in sources)
    assert [d and d.available_s for d in plain] == [d and d.available_s for d in spoiled]


@pytest.mark.slow
def test_fog_takes_contrast_as_koschmieder_says(make_world: MakeWorld) -> None:
    per_m = 0.04
    clear, foggy = (
        Renderer(make_world(sky={"visibility_m": 1e6}, weather=weather)).render(0, HOVER)
        for weather in ({}, {"fog_per_m": per_m})
    )
    model, mount = (getattr(make_world().scenario.camera, name) for name in ("model", "mount"))
    view = CameraView.of(HOVER, mount)
    for metres in (8.0, 11.0, 40.0):  # of ground that is beside the car
        place = np.array([[metres, 3.0, 0.0]])
        x, y = model.pixels(view.to_camera(place))[0].astype(int)
        through = math.exp(-per_m * math.hypot(metres, 3, 6))
        patch = slice(y - 1, y + 2), slice(x - 1, x + 2)
        was, seen = (one[patch].mean(axis=(0, 1)) for one in (clear, foggy))
        assert seen == pytest.approx(was * through + np.array(AIR_LIGHT) * (1 - through), abs=5)
    car = model.pixels(view.to_camera([[14.0, 0.0, -0.8]]))[0].astype(int)
    through = math.exp(-per_m * 15)
    reds = [float(one[car[1], car[0], 2]) - float(one[car[1], car[0], 0]) for one in (clear, foggy)]
    assert reds[1] == pytest.approx(reds[0] * through + (201 - 208) * (1 - through), abs=12)


@pytest.mark.slow
def test_in_thick_fog_there_is_nothing_but_the_airs_light(make_world: MakeWorld) -> None:
    image = Renderer(make_world(weather={"fog_per_m": 1.0})).render(0, HOVER)
    assert np.abs(image.astype(int) - AIR_LIGHT).max() <= 3


def streaks(make_world: MakeWorld, **changes: dict[str, object]) -> Image:
    """Return where rain alone makes the picture brighter, (H, W) grey levels."""
    rain = Renderer(make_world(weather={"rain_mm_h": 100}, **changes)).render(3, HOVER, 0.01)
    veil = Renderer(make_world(weather={"fog_per_m": 0.312e-3 * 100**0.67}, **changes))
    return np.asarray(cv2.absdiff(rain, veil.render(3, HOVER, 0.01)).max(axis=2))


def slope(image: Image) -> float:
    """Return how far streaks lean, right a pixel down, by the structure tensor."""
    across, down = (cv2.Sobel(image, cv2.CV_64F, dx, 1 - dx) for dx in (1, 0))
    return -float((across * down).sum() / (across * across).sum())


@pytest.mark.slow
def test_rain_falls_along_the_image_and_leans_with_the_wind(make_world: MakeWorld) -> None:
    level = {"pitch_deg": 0, "width": 320, "height": 240}
    still = streaks(make_world, camera=level)
    to_the_right = streaks(make_world, camera=level, wind={"mean_m_s": 7, "from_deg": 270})
    assert abs(slope(still)) < 0.15
    assert slope(to_the_right) > 0.4
    assert 0.005 < (still > 20).mean() < 0.3


def test_a_drop_that_passes_the_camera_leaves_its_picture_on_its_own_side() -> None:
    class OneDrop(Rain):
        def _drops(self, rng: np.random.Generator) -> Vector:  # noqa: ARG002
            return np.array([[0.05, 0.05, 0.3]])

    camera = CameraModel.from_fov(320, 240, math.radians(75))
    with_the_rain = BodyState(0.0, (0.0, 0.0, -6.0), (20.0, 0.0, 7.4))
    rain, black = OneDrop(100, camera, CameraMount(), 1), np.zeros((240, 320, 3), np.uint8)
    lit = np.argwhere(rain.fall(black, 0.0, with_the_rain, 0.06, (0.0, 0.0, 0.0))[..., 0])
    assert lit.min(axis=0) == pytest.approx([120, 160], abs=30)
    assert (lit >= [120, 160]).all()


@pytest.mark.slow
def test_more_rain_is_more_streaks_and_no_picture_has_anothers(make_world: MakeWorld) -> None:
    light, violent = (Renderer(make_world(weather={"rain_mm_h": rate})) for rate in (10, 150))
    clear = Renderer(make_world()).render(3, HOVER, 0.01)
    few, many = (
        (cv2.absdiff(one.render(3, HOVER, 0.01), clear)[150:] > 40).mean()
        for one in (light, violent)
    )
    assert many > 3 * few > 0
    assert not np.array_equal(light.render(3, HOVER, 0.01), light.render(3.03, HOVER, 0.01))


def test_the_noise_of_little_light_is_the_photons_and_the_readings() -> None:
    settings = LowLightSettings(stops=5, gain_stops=5, full_well_e=8000, read_noise_e=4)
    sensor = LowLight(settings, (240, 320, 3), np.random.default_rng(1))
    whole = slice(0, 240), slice(0, 320)
    for grey in (60, 120, 200):
        image = sensor.expose(np.full((240, 320, 3), grey, np.uint8), whole).astype(float)
        electrons = (grey / 255) ** 2.2 * 8000 / 2**5
        in_light = math.sqrt(electrons + 4**2) / electrons  # relative, and gamma divides it
        assert image.mean() == pytest.approx(grey, abs=1.0)
        assert image.std() == pytest.approx(grey * in_light / 2.2, rel=0.12)


def test_light_beyond_the_gain_makes_the_picture_darker() -> None:
    settings = LowLightSettings(stops=7, gain_stops=5)
    sensor = LowLight(settings, (48, 64, 3), np.random.default_rng(1))
    image = sensor.expose(np.full((48, 64, 3), 200, np.uint8), (slice(0, 48), slice(0, 64)))
    assert image.mean() == pytest.approx(200 * (1 / 4) ** (1 / 2.2), rel=0.05)


@pytest.mark.parametrize("share", [0.05, 0.3, 0.8])
def test_dirt_covers_its_share_and_stays_where_it_is(share: float) -> None:
    dirt = LensDirt(share, (320, 240), np.random.default_rng(4))
    light, dark = (dirt.over(np.full((240, 320, 3), grey, np.uint8)) for grey in (140, 100))
    through = (light.astype(float) - dark).mean(axis=2) / 40
    assert (through < 0.7).mean() == pytest.approx(share, rel=0.2)
    assert light.min() < 70
    assert light.max() > 160
    assert np.array_equal(light, dirt.over(np.full((240, 320, 3), 140, np.uint8)))


@pytest.mark.slow
@pytest.mark.parametrize("distortion", [(0, 0, 0, 0, 0), (-0.1, 0.02, 0, 0, 0)])
def test_each_row_is_what_a_camera_turned_to_its_time_sees(
    make_world: MakeWorld, distortion: tuple[float, ...]
) -> None:
    world = make_world(camera={"width": 320, "height": 240, "distortion": distortion})
    renderer, camera = Renderer(world), world.scenario.camera
    body, row_time_s = replace(HOVER, rates_rad_s=(0.5, -0.4, 1.5)), 1e-4
    shutter = RollingShutter(row_time_s, camera.model, camera.mount)
    plain = renderer.render(0, body)
    rolled = shutter.read(plain, body.rates_rad_s)
    errors, unmoved = [], []
    for row in (20, 60, 180, 220):
        turned = cv2.Rodrigues(np.array(body.rates_rad_s) * (row + 0.5 - 120) * row_time_s)[0]
        whole = renderer.render(0, seen_from(body, body.body_to_world @ turned))
        inside = slice(12, -12)
        errors.append(np.abs(rolled[row, inside].astype(int) - whole[row, inside]).mean())
        unmoved.append(np.abs(plain[row, inside].astype(int) - whole[row, inside]).mean())
    assert np.less(errors, unmoved).all()
    assert np.mean(errors) < 0.5 * np.mean(unmoved)  # what is left is between pixels
    assert np.abs(rolled[120].astype(int) - plain[120]).mean() < 1


def seen_from(body: BodyState, turn: np.ndarray) -> BodyState:
    """Return the body with the attitude of a rotation matrix."""
    roll, yaw = math.atan2(turn[2, 1], turn[2, 2]), math.atan2(turn[1, 0], turn[0, 0])
    return replace(body, attitude_rad=(roll, math.asin(-turn[2, 0]), yaw))


def test_a_camera_that_does_not_turn_has_nothing_to_roll() -> None:
    settings = SimCameraSettings(width=64, height=48)
    image = np.random.default_rng(1).integers(0, 255, (48, 64, 3), np.uint8)
    shutter = RollingShutter(1e-4, settings.model, settings.mount)
    assert np.array_equal(shutter.read(image, (0.0, 0.0, 0.0)), image)


@pytest.mark.slow
def test_a_longer_exposure_blurs_more_and_more_pictures_leave_no_ghosts(
    make_world: MakeWorld,
) -> None:
    def picture(exposure_s: float, **camera: object) -> Image:
        settings = {"width": 320, "height": 240, **camera}
        body = replace(HOVER, rates_rad_s=(0.0, 0.0, 2.5))
        return Renderer(make_world(camera=settings)).render(0, body, exposure_s)

    def edges(image: Image) -> float:
        return float(np.abs(np.diff(image[140:].astype(int), axis=1)).mean())

    sharpness = [edges(picture(exposure_s)) for exposure_s in (0.0, 0.01, 0.03)]
    assert sharpness == sorted(sharpness, reverse=True)
    assert edges(picture(0.03, blur_steps=16)) < sharpness[-1]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"weather": {"fog_per_m": -0.1}}, "weather: fog_per_m lies between 0 and 1, not -0.1"),
        ({"weather": {"rain_mm_h": math.nan}}, "weather"),
        ({"weather": {"rain": 5}}, "unknown key 'weather.rain'; did you mean 'rain_mm_h'?"),
        ({"weather": {"rain_mm_h": 500}}, "weather: rain_mm_h lies between 0 and 200, not 500"),
        ({"weather": {"rain_mm_h": "much"}}, "weather.rain_mm_h: 'much' is no number"),
        ({"camera": {"low_light": {"stops": -1}}}, "camera.low_light: stops lies between 0 and 14"),
        (
            {"camera": {"low_light": {"full_well_e": 0}}},
            "camera.low_light: full_well_e lies between",
        ),
        ({"camera": {"lens_dirt": 1.0}}, "camera.lens_dirt: Input should be less than or equal to"),
        ({"camera": {"row_time_s": -1e-5}}, "camera.row_time_s: Input should be greater than or"),
        ({"camera": {"blur_steps": 0}}, "camera.blur_steps: Input should be greater than or"),
        (
            {"camera": {"exposure_s": 0.05}},
            "camera: exposure_s is 0.05 s, longer than a frame's 0.0333 s at 30 Hz",
        ),
        (
            {"camera": {"row_time_s": 1e-4}},
            "camera: row_time_s × height is 0.048 s, longer than a frame's 0.0333 s at 30 Hz",
        ),
    ],
)
def test_bad_values_are_named_in_one_line(
    small_world: World, changes: dict[str, object], message: str
) -> None:
    data = small_world.scenario.model_dump() | {"camera": {}} | changes
    with pytest.raises(SettingsError) as caught:
        parse(Scenario, data, "scenario.yaml")
    assert str(caught.value).startswith("scenario.yaml: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
