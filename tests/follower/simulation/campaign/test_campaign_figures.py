"""What a campaign keeps of its flights, and what it counts."""

import io
import json
import math
import resource
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from follower.flight.supervision.supervisor import SupervisorState
from follower.settings.settings import load_settings
from follower.simulation.campaign.config import Goals
from follower.simulation.campaign.metrics import RunMetrics, _broken_places
from follower.simulation.campaign.optimise import present
from follower.simulation.campaign.report import _groups, worst_table
from follower.simulation.campaign.run import judged
from follower.simulation.campaign.store import ROWS, RunStore, read_rows, write_parquet
from follower.simulation.campaign.summary import cost, reacquired_by_length, summary_of, wilson
from follower.simulation.flight import SimulatedFlight
from follower.ui.terminal.console import needed
from follower.workers import job_progress
from follower_control.common.strict_config import SettingsError
from follower_control.envelope.settings import EnvelopeSettings
from follower_sim.kinematics import BodyState, TruthSample
from follower_sim.scoring.occlusions import ObservedFrame, hidden_spans, occlusions

GOOD = RunMetrics(
    time_to_acquire_s=0.5,
    approach_s=4.0,
    scored_s=40.0,
    in_frame_share=1.0,
    in_frame_share_all=0.99,
    line_of_sight_rms_deg=2.0,
    line_of_sight_box_rms_seen_deg=2.0,
    range_error_median=0.05,
    range_error_p95=0.2,
    occlusion_s=(2.0,),
    reacquired_s=(0.3,),
    wrong_end=None,
    losses=1,
    wrong_box_share=0.0,
    delay_median_s=0.07,
    envelope_violations=0,
    nearest_m=9.0,
    keep_out_m=4.0,
    acceleration_rms_m_s2=1.0,
    yaw_acceleration_rms_deg_s2=20.0,
)


def row(number: int = 0, error: str = "", **changes: Any) -> dict[str, Any]:
    figures = replace(GOOD, **changes).to_dict()
    return {
        "key": f"k{number}",
        "number": number,
        "scenario": "pursue-car",
        "autopilot": "px4",
        "seed": 1,
        "vision": "truth+noise",
        "values": {"course": "straight", "wind": 3.0},
        "command": "follower sim pursue-car",
        "version": "0",
        "error": error,
        **({} if error else figures),
        "wall_s": 1.0,
    }


def sample(time_s: float, visible: float) -> TruthSample:
    zero = (0.0, 0.0, 0.0)
    return TruthSample(time_s, BodyState(time_s, zero), zero, zero, 1.0, visible, 9.0, 0.0, 0.0)


def test_wilsons_interval_is_the_roots_of_its_equation() -> None:
    for good, count in ((0, 10), (3, 10), (50, 100), (981, 1000), (7, 7)):
        share, z = good / count, 1.959963984540054
        for bound in wilson(good, count):
            error = abs(bound - share) - z * math.sqrt(bound * (1 - bound) / count)
            assert error == pytest.approx(0, abs=1e-9)
    assert wilson(1, 10) == pytest.approx((0.01788, 0.40415), abs=1e-5)
    assert wilson(0, 0) == (0.0, 1.0)


@given(st.integers(0, 500), st.integers(0, 500))
def test_wilsons_interval_holds_the_share_and_mirrors(good: int, bad: int) -> None:
    low, high = wilson(good, good + bad)
    assert 0 <= low <= high <= 1
    if good + bad:
        assert low - 1e-12 <= good / (good + bad) <= high + 1e-12
    assert wilson(bad, good + bad) == pytest.approx((1 - high, 1 - low))


def test_a_share_of_more_than_all_is_refused() -> None:
    with pytest.raises(ValueError, match="3 of 2"):
        wilson(3, 2)


def test_rows_are_kept_through_a_torn_line_and_appended_after_it(tmp_path: Path) -> None:
    with RunStore(tmp_path) as store:
        store.add(row(1))
        store.add(row(2))
    path = tmp_path / ROWS
    path.write_bytes(path.read_bytes()[:-40])
    with RunStore(tmp_path) as store:
        assert set(store.rows) == {"k1"}
        store.add(row(3))
    assert set(read_rows(path)) == {"k1", "k3"}
    assert read_rows(path)["k1"] == row(1)


def test_a_row_is_on_the_disk_when_it_was_added(tmp_path: Path) -> None:
    with RunStore(tmp_path) as store:
        store.add(row(1))
        assert json.loads((tmp_path / ROWS).read_text("utf-8")) == row(1)


def test_a_row_without_room_is_told_with_its_file_and_costs_no_other(tmp_path: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fly_two() -> None:
        with RunStore(tmp_path) as store:
            store.add(row(1))
            resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
            store.add(row(2))

    try:
        with pytest.raises(OSError, match="too large") as caught:
            fly_two()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert caught.value.filename == str(tmp_path / ROWS)
    with RunStore(tmp_path) as store:
        store.add(row(3))
        assert set(read_rows(store.path)) == {str(row(1)["key"]), str(row(3)["key"])}


def test_two_campaigns_do_not_write_into_one_folder(tmp_path: Path) -> None:
    with RunStore(tmp_path), pytest.raises(SettingsError, match="a campaign is running there"):
        RunStore(tmp_path)


def test_hidden_times_are_joined_over_flickers_and_blinks_are_none() -> None:
    hidden = {*range(10, 40), *range(45, 60), 80, 81, 82}
    truth = [sample(n / 50, 0.0 if n in hidden else 1.0) for n in range(100)]
    assert hidden_spans(truth) == [(0.2, 1.2)]


def test_re_acquisition_is_measured_from_the_occlusions_end_to_what_control_knew() -> None:
    truth = [sample(n / 50, 0.0 if 50 <= n < 100 or 200 <= n < 250 else 1.0) for n in range(500)]
    sighted = [ObservedFrame(1.5, 1.6), ObservedFrame(2.3, 2.4), ObservedFrame(5.5, 5.6)]
    found = occlusions(truth, sighted, 0.0, 10.0)
    assert [one.length_s for one in found] == pytest.approx([1.0, 1.0])
    assert [one.reacquired_s for one in found] == pytest.approx([0.4, 0.6])
    assert occlusions(truth, sighted, 2.0, 10.0)[0].start_s == 4.0
    assert len(occlusions(truth, sighted, 0.0, 5.5)) == 1
    late = [ObservedFrame(5.5, 5.6)]
    for until_s in (10.0, 5.5):  # the next occlusion counts itself, or comes too late for that
        assert occlusions(truth, late, 0.0, until_s)[0].reacquired_s is None
    assert occlusions(truth[:20], [], 0.0, 10.0) == []


@pytest.mark.parametrize(
    ("changes", "failures"),
    [
        ({}, []),
        ({"in_frame_share": 0.98}, ["in frame"]),
        ({"line_of_sight_box_rms_seen_deg": 3.1}, ["line of sight"]),
        ({"reacquired_s": (1.1,)}, ["re-acquisition"]),
        ({"reacquired_s": (None,)}, ["re-acquisition"]),
        ({"occlusion_s": (3.5,), "reacquired_s": (None,)}, []),
        ({"envelope_violations": 1}, ["envelope"]),
        ({"nearest_m": 3.9}, ["keep-out"]),
        ({"nearest_m": 3.9, "keep_out_m": None}, []),
        ({"approach_s": None}, ["never approached"]),
        ({"time_to_acquire_s": None}, ["never followed"]),
        ({"wrong_end": "lost"}, ["lost"]),
    ],
)
def test_each_goal_is_held_against_its_figure(changes: dict[str, Any], failures: list[str]) -> None:
    assert Goals().failures(replace(GOOD, **changes)) == failures


def test_worse_costs_more() -> None:
    worse = (
        {"line_of_sight_box_rms_seen_deg": 4.0},
        {"range_error_median": 0.2},
        {"in_frame_share": 0.9},
        {"reacquired_s": (2.0,)},
        {"acceleration_rms_m_s2": 2.0},
        {"envelope_violations": 1},
        {"approach_s": None},
        {"wrong_end": "not found"},
    )
    for change in worse:
        assert cost(replace(GOOD, **change)) > cost(GOOD)  # type: ignore[arg-type]


def test_another_target_in_the_place_of_ones_own_costs_twice_as_much_as_none() -> None:
    def more(end: str) -> float:
        return cost(replace(GOOD, wrong_end=end)) - cost(GOOD)

    assert (
        more("swap in plain sight") == more("swap under cover") == pytest.approx(2 * more("lost"))
    )


def test_re_acquisition_is_counted_by_whole_seconds_of_cover() -> None:
    figures = [
        replace(GOOD, occlusion_s=(0.4, 5.2), reacquired_s=(0.1, None)),
        replace(GOOD, occlusion_s=(5.9, 0.99), reacquired_s=(1.0, 1.1)),
    ]
    counted = reacquired_by_length(figures, 1.0)
    assert [(name, text.split("; ")[1]) for name, text in counted] == [
        ("0–1 s", "1 of 2)"),
        ("5–6 s", "1 of 2)"),
    ]
    assert reacquired_by_length([], 1.0) == []


def test_goals_are_pooled_over_the_runs() -> None:
    rows = [row(n) for n in range(8)]
    rows += [row(8, line_of_sight_box_rms_seen_deg=9.0), row(9, error="it broke")]
    summary = summary_of(judged(rows, Goals()), Goals())
    assert (summary.runs, summary.passed, summary.errors) == (10, 8, 1)
    assert [one["number"] for one in summary.worst] == [9, 8]
    assert dict(summary.failures) == {"line of sight": 1, "error": 1}
    lines = {line.name: line for line in summary.lines}
    pooled = math.sqrt((8 * 4 + 81) / 9)
    assert f"{pooled:.2f}°" in lines["Line-of-sight error, RMS, outside occlusions"].value
    assert not lines["Line-of-sight error, RMS, outside occlusions"].met
    assert lines["Target in frame, outside occlusions"].met
    assert not summary.reached


def test_where_no_run_could_be_flown_no_goal_is_met() -> None:
    summary = summary_of(judged([row(0, error="it broke")], Goals()), Goals())
    assert {line.verdict for line in summary.goals} == {"not met"}


def test_where_no_run_failed_the_report_says_so() -> None:
    summary = summary_of(judged([], Goals()), Goals())
    said = worst_table(summary, {})
    assert "No run failed." in said
    assert "details" not in said


@pytest.mark.parametrize("state", [SupervisorState.FOLLOWING, SupervisorState.COASTING])
def test_a_place_beyond_the_fence_counts_as_long_as_it_is_steered(state: SupervisorState) -> None:
    place = BodyState(1.0, (90.0, 0.0, -8.0))
    flight = SimpleNamespace(
        log=SimpleNamespace(controls=[SimpleNamespace(time_s=1.0, state=state)]),
        truth=[SimpleNamespace(time_s=1.0, vehicle=place)],
        scenario=SimpleNamespace(start=SimpleNamespace(at=(0.0, 0.0))),
    )
    polygon = EnvelopeSettings(fence_m=((-20, -20), (-20, 20), (80, 20), (80, -20)))
    for limits in (EnvelopeSettings(fence_radius_m=80.0), polygon):
        assert _broken_places(cast(SimulatedFlight, flight), limits) == 1


def test_a_campaign_that_ends_with_another_target_has_not_met_its_goals() -> None:
    rows = [row(0), row(1, wrong_end="swap in plain sight")]
    summary = summary_of(judged(rows, Goals()), Goals())
    (line,) = (line for line in summary.lines if line.name == "Wrong ends")
    assert (line.value, line.wanted, line.verdict) == ("1 of 2 runs", "none", "not met")
    assert not summary.reached


@pytest.mark.parametrize("wanted", [True, False])
def test_the_keep_out_is_a_goal_of_the_campaign_where_it_is_one_of_each_run(wanted: bool) -> None:
    goals = Goals(keep_out=wanted)
    summary = summary_of(judged([row(0, nearest_m=3.9)], goals), goals)
    assert summary.passed == (not wanted)
    assert summary.reached == (not wanted)


def test_results_are_a_parquet_file_with_a_line_a_run(tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    rows = judged([row(0), row(1, reacquired_s=(None,)), row(2, error="it broke")], Goals())
    table = pq.read_table(write_parquet(tmp_path / "results.parquet", rows)).to_pydict()
    assert table["number"] == [0, 1, 2]
    assert table["passed"] == [True, False, False]
    assert table["reacquired_s"] == [[0.3], [None], None]
    assert table["p_wind"] == [3.0, 3.0, 3.0]
    assert table["p_course"] == ["straight"] * 3
    assert table["failures"] == [[], ["re-acquisition"], ["error"]]


@pytest.mark.parametrize(
    ("values", "kept"),
    [((True, False), [True, False]), ((1, 2.5), [1.0, 2.5]), ((True, 2.5), ["True", "2.5"])],
)
def test_a_parameter_keeps_its_kind_in_the_results(
    tmp_path: Path, values: tuple[Any, Any], kept: list[Any]
) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    rows = [{**row(number), "values": {"x": one}} for number, one in enumerate(values)]
    path = write_parquet(tmp_path / "results.parquet", judged(rows, Goals()))
    column = pq.read_table(path)["p_x"].to_pylist()
    assert column == kept
    assert [type(one) for one in column] == [type(one) for one in kept]


def test_results_have_the_same_columns_of_the_same_types_whatever_was_flown(
    tmp_path: Path,
) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    flown = judged([row(0), row(1, reacquired_s=(None,), approach_s=None)], Goals())
    broken = judged([{**row(2, error="it broke"), "of an older version": 1}], Goals())
    schemas = [
        pq.read_schema(write_parquet(tmp_path / "results.parquet", rows))
        for rows in (flown, broken)
    ]
    assert schemas[0].equals(schemas[1])
    types = {name: str(schemas[0].field(name).type) for name in schemas[0].names}
    assert set(RunMetrics.__dataclass_fields__) <= set(types)
    assert types["number"] == "int64"
    assert types["approach_s"] == types["p_wind"] == types["wall_s"] == "double"
    assert types["reacquired_s"].startswith("list<")
    assert "double" in types["reacquired_s"]
    assert types["passed"] == "bool"
    assert [path.name for path in tmp_path.iterdir()] == ["results.parquet"], "no draft is left"


def test_results_that_cannot_be_written_leave_the_old_ones(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    path = write_parquet(tmp_path / "results.parquet", judged([row(0)], Goals()))
    before = path.read_bytes()
    (tmp_path / ".results.parquet.part").mkdir()
    with pytest.raises(OSError, match="results"):
        write_parquet(path, judged([row(0), row(1)], Goals()))
    assert path.read_bytes() == before


def test_progress_is_a_line_now_and_then_where_there_is_no_terminal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("follower.workers._LINE_EVERY_S", 0.0)
    console = Console(file=io.StringIO(), force_terminal=False)
    with job_progress(console, "x", 100, 40) as count_one:
        count_one()
        count_one()
    assert console.file.getvalue().split("\n")[:2] == ["41 of 100 runs", "42 of 100 runs"]


def test_what_a_setting_is_now_is_where_a_search_begins() -> None:
    settings = load_settings()
    assert present(settings, "servo.azimuth.kp") == settings.servo.azimuth.kp
    for wrong in ("servo.azimuth.gain", "servo.mode", "servo.hold_height"):
        with pytest.raises(SettingsError, match="no setting with a number"):
            present(settings, wrong)


def test_without_the_extra_it_says_what_to_install() -> None:
    with pytest.raises(SettingsError, match=r"in the clone: pip install -e '\.\[campaign\]'"):
        needed("follower_has_no_such_module")


def test_what_is_shown_beside_or_never_happened_is_no_goal() -> None:
    rows = [row(0, line_of_sight_rms_deg=9.0, occlusion_s=(), reacquired_s=())]
    summary = summary_of(judged(rows, Goals()), Goals())
    verdicts = {line.name.partition(",")[0]: line.verdict for line in summary.lines}
    assert verdicts["Re-acquired within 1 s"] == ""
    assert [line.verdict for line in summary.lines].count("") == 2
    assert summary.reached


def test_lines_that_are_no_rows_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "runs.jsonl"
    good = '{"key":"k","error":""}'
    path.write_text("\n".join([good, "5", '{"a":1}', "[]", '{"key":"half"']), "utf-8")
    assert list(read_rows(path)) == ["k"]


def test_a_parameters_values_are_shown_in_their_order() -> None:
    rows = [row(number) | {"values": {"gain": value}} for number, value in enumerate((10, 0, 5))]
    assert [label for label, _ in _groups("gain", rows)] == ["0", "5", "10"]
    own = [row(0) | {"scenario": "/somewhere/far/own.yaml"}, row(1)]
    assert [label for label, _ in _groups("scenario", own)] == ["own", "car"]
