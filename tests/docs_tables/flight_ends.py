"""The table of a flight's ends in docs/reference/supervisor.md, from the code's.

    python tests/docs_tables/flight_ends.py

writes it again between the page's two marks; a test checks that it is up to date.
"""

from __future__ import annotations

from marked_part import MarkedPart

from follower.flight.supervision import flight_end as ends
from follower.flight.supervision.flight_end import FlightEnd

FLOWN = {
    "`sim`, `demo`: flown to its end, the limits kept": ends.SUCCEEDED,
    "`sim`, `demo`: flown to its end, a limit not kept": ends.MISSED,
    "`sim`, `demo`: Ctrl-C": ends.BY_CTRL_C,
    "`fly`: Ctrl-C, SIGTERM or the operator's stop": ends.AS_ASKED,
    "`fly`: the same, before anything was followed": ends.NOT_BEGUN,
    "`fly`: the recorded video is over": ends.NO_FRAMES,
    "no room for the recording, and `recorder.when_full: stop`": ends.NOT_RECORDED,
    "`sitl`: the program ended by itself": ends.AUTOPILOT_ENDED,
    "killed by a fault while it followed": ends.BROKEN_OFF,
}
"""The ends that no release explains."""


def ends_markdown() -> str:
    """Return the table's lines."""
    released = {f"released: {reason}": end for reason, end in ends.RELEASES.items()}
    rows = [_row(what, end) for what, end in (FLOWN | released).items()]
    return "\n".join(("| what happened | the end says | exit code |", "|---|---|---|", *rows))


def _row(what: str, end: FlightEnd) -> str:
    return f"| {what} | {end.sentence.format(held='the cause')} | {end.exit_code} |"


ENDS = MarkedPart("reference/supervisor.md", "ends", ends_markdown)

if __name__ == "__main__":
    ENDS.renew()
