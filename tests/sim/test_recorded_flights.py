"""The simulated vehicle beside whole flights of real autopilots, flown again open loop.

Fitted were the files that end in 1 and the first half of px_wind3; these are the others.
"""

import runpy
from pathlib import Path
from typing import Any

import pytest
from real_data import DATA, needs_data

pytestmark = [pytest.mark.slow, needs_data("autopilot_flights")]
BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "autopilot_steps" / "flights.py"


@pytest.fixture(scope="module")
def benchmark(module_path: None) -> dict[str, Any]:  # noqa: ARG001  so that it finds step_replay
    return runpy.run_path(str(BENCHMARK))


@pytest.fixture(scope="module")
def module_path() -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(BENCHMARK.parent))
        yield


def difference(benchmark: dict[str, Any], name: str, from_share: float = 0.0) -> Any:
    real, flown = benchmark["fly_recording"](DATA / "autopilot_flights" / f"{name}.csv")
    from_s = max(5.0, from_share * float(real.time_s[-1]))
    return benchmark["FlightDifference"].between(real, flown, from_s)


@pytest.mark.parametrize(
    ("name", "from_share"),
    [("ap_calm2", 0.0), ("ap_wind2", 0.0), ("px_calm2", 0.0), ("px_wind3", 0.5)],
)
def test_the_simulator_flies_as_the_real_autopilot_did(
    benchmark: dict[str, Any], name: str, from_share: float
) -> None:
    off = difference(benchmark, name, from_share)
    assert off.forward_m_s <= 0.15
    assert off.right_m_s <= 0.15
    assert off.down_m_s <= 0.15
    assert off.yaw_rate_deg_s <= 3.0
    assert off.tilt_deg <= 3.0


def test_at_its_tilt_limit_it_misses_the_velocity_by_as_much(benchmark: dict[str, Any]) -> None:
    off = difference(benchmark, "px_wind2")
    assert off.miss_simulated_m_s == pytest.approx(off.miss_real_m_s, rel=0.2)
