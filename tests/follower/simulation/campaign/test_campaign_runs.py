"""Campaigns that fly: the same rows however they are flown, and none lost when workers die."""

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from program import FOLLOWER, MAIN
from rich.console import Console
from waiting import until

from follower.flight.supervision.flight_end import BY_CTRL_C, SUCCEEDED, FlightEnd
from follower.settings.settings import find_scenario
from follower.simulation.campaign.config import RunSpec, load_campaign, planned
from follower.simulation.campaign.fly import fly_run, fly_runs
from follower.simulation.campaign.optimise import optimise
from follower.simulation.campaign.run import fly_missing, run_campaign
from follower.simulation.campaign.store import ROWS, RunStore, read_rows
from follower.simulation.options import SimulationOptions
from follower.simulation.run import simulate
from follower.workers import DaskEngine, Engine, LocalEngine
from follower_control.common.strict_config import SettingsError

pytestmark = pytest.mark.slow

CONFIG = """
name: small
title: Small.
seed: 3
runs: 3
vision: truth+noise
scenarios: [pursue-person]
autopilots: [px4, ardupilot]
scene: [duration_s=13, targets.0.path.shape.from_s=9]
parameters:
  course: {key: scene.targets.0.path.shape.kind, values: [straight, evasive]}
  wind: {key: scene.wind.mean_m_s, between: [0, 3]}
"""


class Pretending(Engine):
    """Gives each run the row of a function instead of flying it."""

    def __init__(self, row: Callable[[RunSpec], dict[str, Any]]) -> None:
        self._row = row

    def run(self, do: Any, jobs: Any) -> Any:  # noqa: ARG002
        return super().run(self._row, jobs)


def same_angle(spec: RunSpec) -> dict[str, Any]:
    return {**ROW, "key": spec.key, "line_of_sight_box_rms_seen_deg": 2.0}


def config(folder: Path, more: str = "") -> str:
    path = folder / "small.yaml"
    path.write_text(CONFIG + more, encoding="utf-8")
    return str(path)


@pytest.fixture(scope="module")
def specs(tmp_path_factory: pytest.TempPathFactory) -> list[RunSpec]:
    return planned(load_campaign(config(tmp_path_factory.mktemp("campaign"))))


@pytest.fixture(scope="module")
def rows(specs: list[RunSpec]) -> dict[str, dict[str, Any]]:
    """Return the rows as this process flies them."""
    return by_key(fly_runs(Engine(), specs))


def by_key(rows: Any) -> dict[str, dict[str, Any]]:
    """Return rows without what the clock says, as they are after the disk."""
    plain = json.loads(json.dumps(list(rows)))
    return {row["key"]: {k: v for k, v in row.items() if k != "wall_s"} for row in plain}


def test_runs_follow_and_differ(specs: Sequence[RunSpec], rows: dict[str, Any]) -> None:
    assert len(rows) == len(specs)
    for row in rows.values():
        assert row["error"] == ""
        assert row["time_to_acquire_s"] is not None
        assert row["vision"] == "truth+noise"
        assert row["envelope_violations"] == 0
    assert len({row["nearest_m"] for row in rows.values()}) == len(rows)


def test_two_processes_give_the_rows_of_one(specs: list[RunSpec], rows: dict[str, Any]) -> None:
    engine = LocalEngine(2)
    assert by_key(fly_runs(engine, specs)) == rows
    engine.close()


def test_four_dask_workers_one_of_them_killed_give_the_rows_of_one_process(
    specs: list[RunSpec], rows: dict[str, Any]
) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=4, threads_per_worker=1, dashboard_address=":0", host="127.0.0.1"
    ) as cluster:
        engine = DaskEngine(cluster.scheduler_address)
        flown = []
        for row in fly_runs(engine, specs):
            if not flown:
                os.kill(cluster.workers[0].pid, signal.SIGKILL)
            flown.append(row)
        engine.close()
    assert len(flown) == len(specs)
    assert by_key(flown) == rows


def test_a_scheduler_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("follower.workers._CONNECT_S", 0.3)
    with pytest.raises(SettingsError, match=r"--dask tcp://127.0.0.1:9: no scheduler"):
        DaskEngine("tcp://127.0.0.1:9")


def test_an_address_without_a_port_is_refused_at_once_and_leaves_no_client(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(distributed, "Client", None)
    with pytest.raises(SettingsError, match=r"--dask 10.0.0.1: no scheduler.* missing port"):
        DaskEngine("10.0.0.1")


def test_workers_end_with_the_campaign_that_was_killed(tmp_path: Path) -> None:
    command = [*FOLLOWER, "campaign", config(tmp_path), "--out", str(tmp_path / "out")]
    campaign = subprocess.Popen(command)
    try:
        workers = until(lambda: children(campaign.pid), 60.0)
    finally:
        campaign.kill()
        campaign.wait()
    until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in workers), 20.0)


def test_an_engine_that_ends_kills_what_it_flies_and_nothing_else(specs: list[RunSpec]) -> None:
    other = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(120.0,))
    other.start()
    engine = LocalEngine(1)
    try:
        next(fly_runs(engine, specs))
        assert len(multiprocessing.active_children()) == 2
        engine.close()
        until(lambda: multiprocessing.active_children() == [other], 20.0)
    finally:
        other.kill()
        other.join()


def children(pid: int) -> list[int]:
    """Return the processes that fly for a campaign."""
    try:
        listed = Path(f"/proc/{pid}/task/{pid}/children").read_text("ascii").split()
        flying = [
            one for one in listed if b"spawn_main" in Path(f"/proc/{one}/cmdline").read_bytes()
        ]
    except FileNotFoundError:
        return []
    return [int(one) for one in flying]


def has_begun(pid: int) -> bool:
    """Whether a process has its imports behind it: it has had the processor for 3 s."""
    ticks = Path(f"/proc/{pid}/stat").read_text("ascii").rpartition(")")[2].split()[11]
    return int(ticks) > 3 * os.sysconf("SC_CLK_TCK")


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("kept", [0, 1])
def test_a_campaign_that_is_killed_goes_on_to_the_same_table(
    kept: int, rows: dict[str, Any], tmp_path: Path
) -> None:
    """SIGKILL, while it flies its first run or a later one; its last line is half written."""
    pq = pytest.importorskip("pyarrow.parquet")
    out = tmp_path / "out"
    command = [*FOLLOWER, "campaign", config(tmp_path), "--workers", "2", "--out", str(out)]
    killed = subprocess.Popen(command)
    try:
        until(lambda: children(killed.pid), 300.0)
        until(lambda: len(read_rows(out / ROWS)) >= kept, 600.0)
    finally:
        killed.kill()
        killed.wait()
    finished = {key: row["wall_s"] for key, row in read_rows(out / ROWS).items()}
    with (out / ROWS).open("ab") as file:
        file.write(b'{"key":"cut of')
    assert not (out / "results.parquet").exists()
    resumed = subprocess.run(command, check=False)
    assert resumed.returncode in (0, 1)
    table = pq.read_table(out / "results.parquet").to_pylist()
    assert [row["number"] for row in table] == [0, 1, 2]
    nearest = {row["key"]: row["nearest_m"] for row in table}
    assert nearest == {key: row["nearest_m"] for key, row in rows.items()}
    assert by_key(read_rows(out / ROWS).values()) == rows
    assert finished.items() <= {row["key"]: row["wall_s"] for row in table}.items(), "flown twice"


def test_a_stopped_campaign_flies_only_what_is_missing(
    specs: list[RunSpec], rows: dict[str, Any], tmp_path: Path
) -> None:
    flown: list[int] = []

    class Counting(Engine):
        def run(self, do: Any, jobs: Any) -> Any:  # noqa: ARG002
            flown.extend(spec.number for spec in jobs)
            return super().run(lambda spec: dict(rows[spec.key], wall_s=0.1), jobs)

    with RunStore(tmp_path) as store:
        store.add(dict(rows[specs[0].key], wall_s=0.1))
        store.add({**rows[specs[1].key], "error": "its process died", "wall_s": 0.1})
        old = {key: one for key, one in rows[specs[2].key].items() if key != "nearest_m"}
        store.add(old)
    with RunStore(tmp_path) as store:
        fly_missing(specs, Counting(), store, Console(quiet=True), "small")
        assert flown == [1, 2]
        assert by_key(store.rows.values()) == rows


def test_a_run_that_cannot_be_flown_has_a_row_that_says_why(specs: list[RunSpec]) -> None:
    from dataclasses import replace

    engine = LocalEngine(1)
    (row,) = fly_runs(engine, [replace(specs[0], overrides=("servo.distance_m=-1",))])
    engine.close()
    assert row["error"].startswith("SettingsError: --set servo.distance_m=-1")


def test_a_scenario_that_is_edited_while_a_campaign_flies_is_flown_no_further(
    tmp_path: Path,
) -> None:
    own = tmp_path / "own.yaml"
    own.write_bytes(find_scenario("pursue-person").read_bytes())
    file = Path(config(tmp_path))
    file.write_text(file.read_text("utf-8").replace("[pursue-person]", "[own.yaml]"), "utf-8")
    specs = planned(load_campaign(str(file)))
    own.write_text(own.read_text("utf-8") + "# edited\n", "utf-8")
    (row,) = fly_runs(Engine(), specs[:1])
    assert "own.yaml is not what it was when the campaign began" in row["error"]


def test_the_command_of_a_row_gives_its_score(
    specs: list[RunSpec], rows: dict[str, Any], tmp_path: Path
) -> None:
    spec = specs[0]
    simulate(spec.options(out=tmp_path, video=False))
    score = json.loads((tmp_path / "pursue-person" / "score.json").read_text("utf-8"))["score"]
    row = rows[spec.key]
    assert score["in_frame_share"] == row["in_frame_share_all"]
    for name in ("time_to_acquire_s", "approach_s", "line_of_sight_rms_deg", "range_error_median"):
        assert score[name] == row[name]


def test_a_folder_of_something_else_is_not_flown_into(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "report.html").write_text("of a flight", "utf-8")
    with pytest.raises(SettingsError, match="no campaign was begun there"):
        run_campaign(load_campaign(config(tmp_path)), out, LocalEngine(1))
    assert [path.name for path in out.iterdir()] == ["report.html"]


def test_a_whole_campaign_writes_results_and_a_report_that_needs_no_network(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], rows: dict[str, Any]
) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    out = tmp_path / "out"
    with RunStore(out) as store:
        for row in rows.values():
            store.add({**row, "wall_s": 0.1})
    code = run_campaign(load_campaign(config(tmp_path)), out, LocalEngine(1))
    assert code in (0, 1)
    assert "Line-of-sight error, RMS" in capsys.readouterr().out
    table = pq.read_table(out / "results.parquet")
    assert table.num_rows == 3
    assert {"p_course", "p_wind", "passed", "failures"} <= set(table.column_names)
    page = (out / "report.html").read_text("utf-8")
    assert "no pixels: vision from truth + noise" in page
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "https://" not in page
    worst = [row for row in table.to_pylist() if not row["passed"]]
    for row in worst:
        assert row["command"] in page.replace("&#x27;", "'")


def test_where_no_run_failed_none_is_flown_again_and_the_end_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], rows: dict[str, Any]
) -> None:
    pytest.importorskip("pyarrow.parquet")
    met = {"time_to_acquire_s": 0.1, "approach_s": 1.0, "wrong_end": None, "in_frame_share": 1.0}
    met |= {"line_of_sight_box_rms_seen_deg": 1.0, "occlusion_s": [], "reacquired_s": []}
    met |= {"envelope_violations": 0}
    with RunStore(tmp_path / "out") as store:
        for row in rows.values():
            store.add({**row, **met})
    goals = "goals: {keep_out: false}\n"
    run_campaign(load_campaign(config(tmp_path, goals)), tmp_path / "out", LocalEngine(1), videos=2)
    assert "No run failed: none was flown again with video." in capsys.readouterr().out
    assert not (tmp_path / "out" / "worst").exists()


class Filming:
    """In place of `simulate`: leaves a folder, and ends as it is told."""

    def __init__(self, end: FlightEnd = SUCCEEDED) -> None:
        self._end = end
        self.folders: list[Path] = []

    def __call__(self, options: SimulationOptions) -> Any:
        folder = options.out / options.scenario
        folder.mkdir(parents=True)
        self.folders.append(folder)
        return SimpleNamespace(end=self._end, folder=folder)


def failing(spec: RunSpec) -> dict[str, Any]:
    """Return the row of a run that misses a goal; of the first run, that it cannot be flown."""
    if spec.number == 0:
        raise ValueError("no such gain")
    known = {"number": spec.number, "scenario": spec.scenario, "autopilot": spec.autopilot}
    angle = 9.0 + spec.number
    row = {**same_angle(spec), **known, "line_of_sight_box_rms_seen_deg": angle, "version": "1"}
    return row | {"values": dict(spec.values)}


def test_only_runs_that_could_be_flown_are_filmed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pyarrow.parquet")
    monkeypatch.setattr("follower.simulation.campaign.run.simulate", film := Filming())
    out = tmp_path / "out"
    assert run_campaign(load_campaign(config(tmp_path)), out, Pretending(failing), videos=1) == 1
    assert film.folders == [out / "worst/0002/pursue-person"]
    page = (out / "report.html").read_text("utf-8")
    assert "worst/0002/pursue-person/overlay.mp4" in page
    assert "no such gain" in page


def test_ctrl_c_while_it_films_ends_the_campaign_with_its_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyarrow.parquet")
    monkeypatch.setattr("follower.simulation.campaign.run.simulate", film := Filming(BY_CTRL_C))
    out = tmp_path / "out"
    assert run_campaign(load_campaign(config(tmp_path)), out, Pretending(failing), videos=2) == 130
    assert [folder.exists() for folder in film.folders] == [False]
    assert "overlay.mp4" not in (out / "report.html").read_text("utf-8")
    assert capsys.readouterr().out.rstrip().endswith("the same command goes on.")


def test_a_search_begins_with_what_there_is_and_can_be_repeated(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    more = "optimise: {trials: 4, runs_per_trial: 2, settings: {servo.azimuth.kp: [0.5, 3]}}\n"
    campaign = load_campaign(config(tmp_path, more))
    specs, flown = planned(campaign), []

    def pretended(spec: RunSpec) -> dict[str, Any]:
        flown.append(spec.key)
        angle = 1.0 + abs(float(spec.overrides[-1].partition("=")[2]) - 2.0)
        return {**ROW, "key": spec.key, "line_of_sight_box_rms_seen_deg": angle}

    for _ in range(2):
        with RunStore(tmp_path / "out") as store:
            quiet = Console(quiet=True)
            optimise(campaign, specs, Pretending(pretended), store, tmp_path / "out", quiet)
    assert len(flown) == 8, "the second search finds every run of the first"
    trials = json.loads((tmp_path / "out" / "trials.json").read_text("utf-8"))
    assert trials[0]["servo.azimuth.kp"] == 1.25, "the scenario's own, which the campaign flies"
    best = min(trials, key=lambda trial: trial["cost"])
    assert (tmp_path / "out" / "best.yaml").read_text("utf-8").split() == [
        *("servo:", "azimuth:", "kp:", str(best["servo.azimuth.kp"]))
    ]


def test_a_search_flies_again_what_could_not_be_flown_or_lacks_a_figure(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    more = "optimise: {trials: 1, runs_per_trial: 2, settings: {servo.azimuth.kp: [0.5, 3]}}\n"
    campaign, out, quiet = (
        load_campaign(config(tmp_path, more)),
        tmp_path / "out",
        Console(quiet=True),
    )
    specs, flown = planned(campaign), []

    def pretended(spec: RunSpec) -> dict[str, Any]:
        flown.append(spec.number)
        return same_angle(spec)

    with RunStore(out) as store:
        optimise(campaign, specs, Pretending(pretended), store, out, quiet)
        first, second = store.rows.values()
        store.add({**first, "error": "its process died"})
        store.add({name: value for name, value in second.items() if name != "wrong_end"})
        optimise(campaign, specs, Pretending(pretended), store, out, quiet)
    assert flown == [0, 1, 0, 1]
    (trial,) = json.loads((out / "trials.json").read_text("utf-8"))
    assert trial["cost"] < 20


def test_a_search_tries_whole_numbers_where_a_setting_is_one(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    more = "optimise: {trials: 4, settings: {fusion.validate_every: [1.5, 9.5]}}\n"
    campaign, out = load_campaign(config(tmp_path, more)), tmp_path / "out"

    def resolved(spec: RunSpec) -> dict[str, Any]:
        spec.options().resolve()
        return same_angle(spec)

    with RunStore(out) as store:
        quiet = Console(quiet=True)
        assert optimise(campaign, planned(campaign), Pretending(resolved), store, out, quiet) == 0
    tried = {one["fusion.validate_every"] for one in json.loads((out / "trials.json").read_text())}
    assert len(tried) > 1
    assert tried <= set(range(2, 10))


def test_a_search_says_that_runs_could_not_be_flown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("optuna")
    more = "optimise: {trials: 2, runs_per_trial: 2, settings: {servo.azimuth.kp: [0.5, 3]}}\n"
    code = run_campaign(
        load_campaign(config(tmp_path, more)), tmp_path / "out", Pretending(failing), searching=True
    )
    assert code == 1
    assert "2 of 4 runs could not be flown, the first one: ValueError" in capsys.readouterr().out


ROW: dict[str, Any] = {
    "error": "",
    "time_to_acquire_s": 0.5,
    "approach_s": 4.0,
    "scored_s": 40.0,
    "in_frame_share": 1.0,
    "in_frame_share_all": 1.0,
    "line_of_sight_rms_deg": 1.0,
    "range_error_median": 0.05,
    "range_error_p95": 0.1,
    "occlusion_s": [],
    "reacquired_s": [],
    "wrong_end": None,
    "losses": 0,
    "wrong_box_share": 0.0,
    "delay_median_s": 0.07,
    "envelope_violations": 0,
    "nearest_m": 9.0,
    "keep_out_m": 4.0,
    "acceleration_rms_m_s2": 1.0,
    "yaw_acceleration_rms_deg_s2": 10.0,
}


@pytest.mark.parametrize("key", ["servo.azimuth.kp: [2, 3]", "servo.azimuth.gain: [0, 1]"])
def test_a_search_that_cannot_begin_is_refused(tmp_path: Path, key: str) -> None:
    pytest.importorskip("optuna")
    campaign = load_campaign(config(tmp_path, f"optimise: {{settings: {{{key}}}}}\n"))
    with (
        RunStore(tmp_path / "out") as store,
        pytest.raises(SettingsError, match=r"optimise\.settings"),
    ):
        optimise(
            campaign,
            planned(campaign),
            Engine(),
            store,
            tmp_path / "out",
            Console(quiet=True),
        )


def test_the_best_settings_stand_among_those_of_the_campaigns_file(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    (tmp_path / "base.yaml").write_text("servo: {elevation: {kp: 0.4}}\n", "utf-8")
    more = "config: base.yaml\noptimise: {trials: 1, settings: {servo.azimuth.kp: [0.5, 3]}}\n"
    campaign = load_campaign(config(tmp_path, more))

    with RunStore(tmp_path / "out") as store:
        quiet = Console(quiet=True)
        optimise(
            campaign, planned(campaign), Pretending(same_angle), store, tmp_path / "out", quiet
        )
    best = yaml.safe_load((tmp_path / "out" / "best.yaml").read_text("utf-8"))
    assert best == {"servo": {"elevation": {"kp": 0.4}, "azimuth": {"kp": 1.25}}}


def test_a_search_that_is_stopped_writes_what_it_has_found(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    more = "optimise: {trials: 5, settings: {servo.azimuth.kp: [0.5, 3]}}\n"
    campaign = load_campaign(config(tmp_path, more))

    class Stopped(Pretending):
        asked = 0

        def run(self, do: Any, jobs: Any) -> Any:
            self.asked += 1
            if self.asked == 3:
                raise KeyboardInterrupt
            return super().run(do, jobs)

    with RunStore(tmp_path / "out") as store:
        quiet = Console(quiet=True)
        code = optimise(
            campaign, planned(campaign), Stopped(same_angle), store, tmp_path / "out", quiet
        )
    assert code == 130
    assert len(json.loads((tmp_path / "out" / "trials.json").read_text("utf-8"))) == 2
    assert (tmp_path / "out" / "best.yaml").is_file()


@pytest.mark.parametrize("flying", [False, True])
def test_ctrl_c_ends_a_campaign_at_once_and_without_noise(tmp_path: Path, flying: bool) -> None:
    """It goes to all processes of the terminal, while they begin as well as while they fly."""
    path = config(tmp_path)
    text = Path(path).read_text("utf-8").replace("runs: 3", "runs: 60")
    Path(path).write_text(text.replace("duration_s=13", "duration_s=300"), "utf-8")
    # As from a terminal, wherever the tests run: what a script begins with `&` is deaf to Ctrl-C.
    hears = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    command = [sys.executable, "-c", f"{hears}; {MAIN}"]
    out = tmp_path / "out"
    process = subprocess.Popen(
        [*command, "campaign", path, "--workers", "2", "--out", str(out)],
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        until((out / "campaign.yaml").exists)
        if flying:
            until(lambda: any(map(has_begun, children(process.pid))), 60.0)
        time.sleep(1.0)
        os.killpg(process.pid, signal.SIGINT)
        said, _ = process.communicate(timeout=60)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    assert process.returncode == 130
    assert "Traceback" not in said
    assert "Stopped" in said


def test_flying_twice_gives_the_same_row(specs: list[RunSpec], rows: dict[str, Any]) -> None:
    assert by_key([fly_run(specs[2])])[specs[2].key] == rows[specs[2].key]
