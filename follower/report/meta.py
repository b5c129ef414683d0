"""What a report says about a run that its log does not know."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ReportMeta:
    """What was run, and how to run it again.

    Attributes:
        title: the page's headline, e.g. the scenario's title.
        subtitle: a line below it, e.g. autopilot, seed, lockstep or real time.
        command: the command line that does this run again.
        settings_yaml: all settings as resolved.
        facts: (name, value) pairs worth knowing: versions, machine, seed.
        files: (file name, what it is) of what else lies in the folder.
        video: the name of a video in the folder to show, "" if there is none.
        remarks: lines that the reader must know, e.g. that the flight was interrupted.
    """

    title: str
    subtitle: str = ""
    command: str = ""
    settings_yaml: str = ""
    facts: tuple[tuple[str, str], ...] = ()
    files: tuple[tuple[str, str], ...] = ()
    video: str = ""
    remarks: tuple[str, ...] = ()
