"""A disk without room: the flight comes first, then what was written, then the reports.

The kernel itself says no: to files that grow beyond a limit, to /dev/full, and where a small file
system can be mounted, there.
"""

import re
import resource
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from program import FOLLOWER
from small_scenario import small_scenario

from follower.apps.inspect import inspect_flight
from follower.flight.supervision.flight_end import RELEASED_FOR_SAFETY, SUCCESS
from follower.flight.supervision.supervisor import SupervisorState
from follower.flight.vision.video_sink import OverlayVideo
from follower.recording import open_flight
from follower.recording.run_folder import RunFiles, write_setpoints
from follower_vision.images.frame import Frame

SMALL = small_scenario(16)
MOUNTED = ("unshare", "-rm", "sh", "-ec", 'mount -t tmpfs -o size=800k none "$0"; exec "$@"')
MOST_BYTES = 250_000
SETTINGS = ("--set", "recorder.keep_free_mb=0")


def limit_files() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (MOST_BYTES, MOST_BYTES))


def follower(*arguments: str, before: tuple[str, ...] = (), **options: Any) -> tuple[int, str]:
    done = subprocess.run(
        [*before, *FOLLOWER, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
        **options,
    )
    return done.returncode, done.stdout


def warnings(said: str) -> list[str]:
    return [line for line in said.splitlines() if line.startswith("Recorder: the log")]


@pytest.mark.slow
@pytest.mark.parametrize("clock", [("--lockstep",), ()], ids=["lockstep", "real time"])
def test_the_flight_goes_on_is_scored_and_what_was_written_opens(
    tmp_path: Path, clock: tuple[str, ...]
) -> None:
    (tmp_path / "small.yaml").write_text(SMALL, "utf-8")
    code, said = follower(
        *("sim", "small.yaml", *clock, *SETTINGS), cwd=tmp_path, preexec_fn=limit_files
    )
    assert code == SUCCESS, said
    assert "The pursuit succeeded" in said
    (warning,) = warnings(said)
    assert re.search(r"File too large \(runs/small/\S+, [\d.]+ MB free\)", warning)
    flight = open_flight(tmp_path / "runs" / "small")
    assert flight.log.controls[-1].state is SupervisorState.FOLLOWING
    assert sum(file.suffix == ".part" for file in flight.folder.iterdir()) == 0


@pytest.mark.slow
def test_a_setting_makes_it_stop_instead(tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text(SMALL, "utf-8")
    code, said = follower(
        *("sim", "small.yaml", "--lockstep", *SETTINGS, "--set", "recorder.when_full=stop"),
        cwd=tmp_path,
        preexec_fn=limit_files,
    )
    assert code == RELEASED_FOR_SAFETY, said
    assert "Released: no room for the recording" in said
    last_s = max(float(s) for s in re.findall(r"([\d.]+)/16 s  ", said))
    assert last_s < 15


@pytest.mark.slow
def test_on_a_small_file_system_too_and_inspect_reports_elsewhere(tmp_path: Path) -> None:
    mount = tmp_path / "mount"
    mount.mkdir()
    if subprocess.run([*MOUNTED, str(mount), "true"], check=False).returncode:
        pytest.skip("mounting a small file system is not permitted here")
    (tmp_path / "small.yaml").write_text(SMALL, "utf-8")
    fly = f'"$@" sim small.yaml --lockstep --out mount {" ".join(SETTINGS)}'
    script = f'{fly}; "$@" inspect mount/small'
    code, said = follower(before=(*MOUNTED, str(mount), "sh", "-ec", script, "sh"), cwd=tmp_path)
    assert code == SUCCESS, said
    (warning,) = warnings(said)
    assert re.search(r"No space left on device \(mount/small/\S+, 0.0 MB free\)", warning)
    assert "No room for boxes.csv" in said
    assert "The report is not in the flight's folder: No space left on device" in said
    assert (tmp_path / "small-inspection.html").stat().st_size > 10_000


def without_room(path: Path) -> None:
    """Have the kernel say that there is no room for this file."""
    path.with_name(f".{path.name}.part").symlink_to("/dev/full")


@pytest.mark.slow
def test_inspect_writes_where_there_is_room_and_says_so(
    small_flight: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    folder = tmp_path / "flight"
    folder.mkdir()
    for file in Path(small_flight.folder).iterdir():
        (folder / file.name).symlink_to(file.resolve())
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    without_room(folder / "inspection.html")
    assert inspect_flight(folder) == Path("flight-inspection.html")
    assert f"No space left on device ({folder / 'inspection.html'}, " in capsys.readouterr().out
    without_room(folder / "inspection.html")
    without_room(tmp_path / "flight-inspection.html")
    last = inspect_flight(folder)
    assert last.parent.name.startswith("follower-")
    assert last.stat().st_size > 10_000


@pytest.mark.slow
def test_a_named_place_without_room_is_one_line_with_the_file_and_what_is_free(
    small_flight: Any, tmp_path: Path
) -> None:
    report = tmp_path / "report.html"
    without_room(report)
    code, said = follower("inspect", str(small_flight.folder), "--out", str(report))
    assert code == 2
    assert re.fullmatch(
        rf"follower: No space left on device \({re.escape(str(report))}, [\d.]+ MB free\)\n", said
    )
    assert list(tmp_path.iterdir()) == []


def test_a_runs_file_without_room_is_a_remark_and_leaves_nothing(tmp_path: Path) -> None:
    files = RunFiles(tmp_path)
    files.write("setpoints.csv", lambda path: write_setpoints(path, ()))
    assert files.remarks == ()
    without_room(tmp_path / "boxes.csv")
    files.write("boxes.csv", lambda path: write_setpoints(path, ()))
    (remark,) = files.remarks
    assert remark.startswith(f"No room for boxes.csv ({tmp_path}, ")
    assert [path.name for path in tmp_path.iterdir()] == ["setpoints.csv"]


def test_an_overlay_without_room_is_a_remark_and_no_end() -> None:
    rng = np.random.default_rng(3)
    with OverlayVideo(Path("/dev/full"), 30.0) as video:
        for number in range(300):
            image = rng.integers(0, 255, (96, 128, 3), dtype=np.uint8)
            video.add(Frame(image, number / 30, number), (), ())
    assert video.remark is not None
    assert "No space left on device (/dev/full, " in video.remark
