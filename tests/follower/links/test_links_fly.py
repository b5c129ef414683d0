"""One whole pursuit, in real time over UDP, by both links and both autopilots."""

import json
from pathlib import Path

import pytest
import yaml
from small_scenario import small_scenario

from follower.simulation.options import SimulationOptions
from follower.simulation.run import simulate


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "flavour"), [("pymavlink", "px4"), ("mavsdk", "ardupilot")])
def test_a_pursuit_is_flown(kind: str, flavour: str, tmp_path: Path) -> None:
    scenario = tmp_path / "small.yaml"
    scenario.write_text(small_scenario(11, 5))
    simulate(
        SimulationOptions(
            str(scenario),
            autopilot=flavour,
            out=tmp_path,
            video=False,
            link=kind,
        )
    )
    score = json.loads((tmp_path / "small" / "score.json").read_text())["score"]
    assert score["following_share"] > 0.8
    assert score["in_frame_share"] > 0.9
    assert score["range_error_median"] < 0.25
    config = yaml.safe_load((tmp_path / "small" / "config.yaml").read_text())
    assert config["settings"]["link"]["kind"] == kind
    report = (tmp_path / "small" / "report.html").read_text()
    assert f"{kind} to {flavour} 1, " in report
    assert (tmp_path / "small" / "mavlink.tlog").stat().st_size > 100_000
