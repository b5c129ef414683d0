"""Excite, identify and tune on real autopilots, and what the new gains bring there.

Each program that ARDUCOPTER_SITL and PX4_SITL name flies the test pattern and one pursuit with the
camera; a model is fitted to both, gains are found for it, and the pursuit is flown three times with
the usual gains and three times with the new ones, without pixels.

    python benchmarks/sitl_tuning.py [--out runs/sitl_tuning] [--scenario winding]
"""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import command_line
import numpy as np

from follower.apps.sitl.run import programs
from follower.simulation.sitl.process import AutopilotProcess
from follower.simulation.sitl.programs import SitlProgram, SitlSetup

FIGURES = ("line_of_sight_rms_deg", "range_error_median", "in_frame_share")


def follower(*words: object) -> None:
    """Run the follower's own command and let it speak."""
    command = [sys.executable, "-c", "from follower.apps.main import main; main()"]
    subprocess.run([*command, *map(str, words)], check=False)


def excite(program: SitlProgram, folder: Path) -> Path:
    """Fly the test pattern; return its recording."""
    with closing(program.listen()):
        pass  # the follower's process opens the port that was free
    setup = SitlSetup(parameters=program.usual_parameters())
    with AutopilotProcess(program, setup, folder):
        where = ("--connect", f"udpin:127.0.0.1:{program.port}")
        follower("excite", *where, "--set", "autonomy=full", "--out", folder)
    return folder / "excite"


def flown(program: SitlProgram, scenario: str, out: Path, *more: object) -> list[dict[str, object]]:
    """Fly the scenario; return the rows of the report."""
    follower("sitl", scenario, *program.words, "--no-video", "--out", out, *more)
    rows: list[dict[str, object]] = json.loads((out / "sitl" / "results.json").read_text("utf-8"))
    return rows


def tune(program: SitlProgram, scenario: str, out: Path) -> None:
    """Do all of it on one program, and print."""
    out.mkdir(parents=True)
    pattern = excite(program, out)
    flown(program, scenario, out / "camera")
    (camera,) = (path.parent for path in (out / "camera").glob("sitl/*/flight.mcap"))
    follower("identify", pattern, camera, "--out", out)
    vehicle, tuned = out / "identify" / "vehicle.yaml", out / "tune" / "tuned.yaml"
    follower("tune", vehicle, "--scenario", scenario, "--out", out)
    quick = ("--vision", "truth+noise", "--repeat", 3, "--speedup", 2)
    usual = flown(program, scenario, out / "usual", *quick)
    new = flown(program, scenario, out / "new", *quick, "-c", tuned)
    for name in FIGURES:
        before, after = ([float(str(row[name])) for row in rows] for rows in (usual, new))
        print(
            f"{program.title} {name}: usual {np.mean(before):.3f} ± {np.std(before):.3f}, "
            f"tuned {np.mean(after):.3f} ± {np.std(after):.3f}",
            flush=True,
        )


def main() -> None:
    """Tune on the programs that are named."""
    parser = command_line.parser(__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/sitl_tuning"))
    parser.add_argument("--scenario", default="winding")
    options = parser.parse_args()
    for program in programs(None, None, None, None):
        if program is not None:
            tune(program, options.scenario, options.out / program.flavour)


if __name__ == "__main__":
    command_line.run(main)
