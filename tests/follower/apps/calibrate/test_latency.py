"""`follower calibrate latency`: how late a camera's stamps are, from the vehicle's own turns."""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from follower.apps.calibrate.latency import Turns, run
from follower.apps.import_flight.alignment import corner_flows
from follower.apps.main import app
from follower.recording.telemetry_logs.samples import TelemetrySamples
from follower.settings.settings import load_settings
from follower_control.common.strict_config import SettingsError
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.geometry.line_of_sight import CameraMount
from follower_vision.images.frame import Frame

CAMERA = CameraModel.from_fov(320, 240, math.radians(70))
RATE_HZ, SECONDS = 20, 14


def yaw_rad(time_s: float, swing: float) -> float:
    return swing * (0.3 * math.sin(2.1 * time_s) + 0.08 * math.sin(5.3 * time_s + 1))


def frames(swing: float, late_s: float) -> Iterator[Frame]:
    """A wall of blots far away, seen by a camera that turns and stamps its frames late."""
    noise = np.random.default_rng(3).integers(0, 255, (60, 120, 3), np.uint8)
    wall = cv2.resize(noise, (1200, 600), interpolation=cv2.INTER_CUBIC)
    to_ray = np.array([[1, 0, -600], [0, 1, -300], [0, 0, CAMERA.fx]])
    for number in range(RATE_HZ * SECONDS):
        time_s = number / RATE_HZ
        c, s = math.cos(yaw_rad(time_s, swing)), math.sin(yaw_rad(time_s, swing))
        turn = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        image = cv2.warpPerspective(wall, CAMERA.matrix @ turn @ to_ray, (320, 240))
        yield Frame(np.asarray(image, np.uint8), time_s + late_s, number)


def turns(swing: float, late_s: float) -> Turns:
    samples = TelemetrySamples()
    for time_s in np.arange(0, SECONDS, 0.02).tolist():
        rate = (yaw_rad(time_s + 1e-4, swing) - yaw_rad(time_s - 1e-4, swing)) / 2e-4
        samples.attitudes.append((time_s, 0.0, 0.0, yaw_rad(time_s, swing)))
        samples.attitude_rates.append((0.0, 0.0, rate))
    flows = list(corner_flows(frames(swing, late_s), CAMERA))
    return Turns("the wall", flows, samples.log("here"), CameraMount(0.0, 0.0, 0.0))


@pytest.mark.slow
@pytest.mark.parametrize("late_s", [0.137, -0.02])
def test_the_delay_is_found_to_milliseconds_and_written_with_the_users_settings(
    late_s: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text("camera: {pitch_deg: -30, latency_s: 0.5}\nservo: {distance_m: 9}\n")
    out = tmp_path / "new" / "latency.yaml"
    assert run(turns(1.0, late_s), out, mine) == 0
    settings = load_settings(out)
    assert settings.camera.latency_s == pytest.approx(late_s, abs=0.005)
    assert (settings.camera.pitch_deg, settings.servo.distance_m) == (-30, 9)
    said = " ".join(capsys.readouterr().out.split())
    assert f"delay {settings.camera.latency_s:.3f} s ±" in said
    assert out.with_suffix(".png").stat().st_size > 10_000
    with pytest.raises(SettingsError, match="exists already"):
        run(turns(1.0, late_s), out)


def test_too_little_turning_is_refused_and_leaves_nothing_behind(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(turns(0.02, 0.1), tmp_path / "latency.yaml") == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "No calibration: the vehicle hardly turns" in said
    assert "Turn left and right by 30 degrees" in said
    assert list(tmp_path.iterdir()) == []


def test_a_moment_is_too_short(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    long = turns(0.02, 0.0)
    short = replace(long, flows=long.flows[:RATE_HZ])
    assert run(short, tmp_path / "latency.yaml") == 1
    assert "at least 4 s of both are needed" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ((), "folder, or --connect and a camera"),
        (("runs/x", "--connect", "udpin:127.0.0.1:1"), "not both"),
        (("--connect", "udpin:127.0.0.1:1"), "which source"),
    ],
)
def test_it_says_what_it_needs(options: tuple[str, ...], says: str) -> None:
    with pytest.raises(SettingsError, match=says):
        CliRunner().invoke(app, ["calibrate", "latency", *options], catch_exceptions=False)


def test_calibrate_s_help_names_lens_and_latency() -> None:
    said = CliRunner().invoke(app, ["calibrate", "--help"]).output
    assert "latency" in said
    assert "lens" in said
