"""How work is spread: each job once, and a process that dies or hangs costs its own job alone."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from follower.workers import (
    DaskEngine,
    Engine,
    JobError,
    LocalEngine,
    engine_for,
)
from follower_control.common.interrupt import interrupted_later
from follower_control.common.strict_config import SettingsError

pytestmark = pytest.mark.slow


class StubbornError(Exception):
    """Cannot be made anew from what it holds."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(first + second)


def work(job: Any) -> Any:
    """Do what a job says."""
    match job:
        case "die":
            os.kill(os.getpid(), signal.SIGKILL)
        case "hang":
            time.sleep(600)
        case "fail":
            raise StubbornError("no", "thing")
        case ("die once", Path() as mark) if not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        case int():
            return job * job
    return "done"


@pytest.fixture(params=["processes", "dask"])
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    """Two workers, in which no job may take longer than some seconds."""
    if request.param == "processes":
        with closing(LocalEngine(2, longest_s=3.0)) as local:
            yield local
        return
    distributed = pytest.importorskip("distributed")
    with (
        pytest.importorskip("dask").config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=":0", host="127.0.0.1"
        ) as cluster,
        closing(DaskEngine(cluster.scheduler_address, longest_s=3.0)) as remote,
    ):
        yield remote


def test_a_job_that_kills_or_hangs_its_process_costs_itself_alone(engine: Engine) -> None:
    jobs = [0, "die", 1, 2, "hang", 3, 4, "fail", 5, 6, 7]
    done = list(engine.run(work, jobs))
    assert sorted(one.value for one in done if not one.failure) == [0, 1, 4, 9, 16, 25, 36, 49]
    failures = {one.job: one.failure for one in done if one.failure}
    assert sorted(failures) == ["die", "fail", "hang"]
    assert failures["fail"] == "StubbornError: nothing"
    assert len(done) == len(jobs)


def test_what_a_dead_process_had_in_hand_is_done_by_another(engine: Engine, tmp_path: Path) -> None:
    (done,) = engine.run(work, [("die once", tmp_path / "mark")])
    assert done.result == "done"


def test_a_job_that_is_given_up_says_how_often_it_was_tried() -> None:
    with closing(LocalEngine(1)) as engine:
        (done,) = engine.run(work, ["die"])
        with pytest.raises(JobError, match=r"its process died, .* 3 times"):
            _ = done.result


def test_processes_are_kept_for_the_next_jobs_and_replaced_where_they_are_gone() -> None:
    with closing(LocalEngine(1)) as engine:
        assert [one.result for one in engine.run(work, [2])] == [4]
        (process,) = multiprocessing.active_children()
        assert [one.result for one in engine.run(work, [3])] == [9]
        assert multiprocessing.active_children() == [process]
        process.kill()
        process.join()
        assert [one.result for one in engine.run(work, [4])] == [16]
    assert not multiprocessing.active_children()


def test_jobs_that_are_not_waited_for_end_with_the_engine() -> None:
    with closing(LocalEngine(2)) as engine:
        done = engine.run(work, [1, "hang"])
        assert next(done).result == 1
        done.close()
    assert not multiprocessing.active_children()


def test_without_workers_jobs_are_done_here_and_in_their_order() -> None:
    engine = engine_for(0, None)
    assert type(engine) is Engine
    assert [one.value for one in engine.run(work, [1, "fail", 2])] == [1, None, 4]


def test_a_scheduler_that_goes_away_is_named() -> None:
    distributed = pytest.importorskip("distributed")
    cluster = distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=":0", host="127.0.0.1"
    )
    with cluster, closing(DaskEngine(cluster.scheduler_address)) as engine:
        done = engine.run(work, [1, "hang"])
        assert next(done).result == 1
        cluster.close()
        with pytest.raises(SettingsError, match="the scheduler is gone; what is finished is kept"):
            next(done)


@pytest.mark.parametrize(
    ("workers", "said"), [(0, "it has no workers"), (1, "a worker has several threads")]
)
def test_a_cluster_that_cannot_do_jobs_one_a_process_is_refused(workers: int, said: str) -> None:
    """Of two jobs in one process, one that hangs was never ended."""
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=2,
            processes=False,
            protocol="tcp",
            dashboard_address=":0",
            host="127.0.0.1",
        ) as cluster,
        pytest.raises(
            SettingsError, match=rf"{said}; start them with `dask worker tcp://\S+ --nth"
        ),
    ):
        DaskEngine(cluster.scheduler_address)


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """Ctrl-C raises: whoever is begun in the background of a shell ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_waits_until_a_process_has_begun() -> None:
    done: list[str] = []

    def begin() -> None:
        with interrupted_later():
            signal.raise_signal(signal.SIGINT)
            done.append("begun")

    with pytest.raises(KeyboardInterrupt):
        begin()
    assert done == ["begun"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


BLOCKED = """
import signal
from contextlib import closing
from follower.workers import LocalEngine

def blocked(_):
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())

if __name__ == "__main__":
    with closing(LocalEngine(2)) as engine:
        print([done.result for done in engine.run(blocked, "ab")])
"""


def test_ctrl_c_reaches_no_worker_not_even_the_first_one(tmp_path: Path) -> None:
    """Python's own resource tracker is begun with the first one, and lifts what was blocked."""
    script = tmp_path / "blocked.py"
    script.write_text(BLOCKED, encoding="utf-8")
    said = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True)
    assert said.stdout == "[True, True]\n"
