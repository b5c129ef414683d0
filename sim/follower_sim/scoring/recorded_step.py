"""Step responses as they were recorded from an autopilot, or flown again in the simulator."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]

_ANGLES = ("roll", "pitch", "yaw")
_SENT = ("sp_frame", "sp_mask", "sp_vx", "sp_vy", "sp_vz", "sp_yawrate")
STEP_COLUMNS = ("t_boot", "vx", "vy", "vz", *_ANGLES, "r", *_SENT)
"""Of the CSV file: time in s, velocity NED in m/s, attitude and its rate about down in rad and
rad/s; the setpoint then streamed, as in SET_POSITION_TARGET_LOCAL_NED, else empty."""


@dataclass(frozen=True, slots=True)
class SentSetpoint:
    """What was streamed from a time on, as SET_POSITION_TARGET_LOCAL_NED."""

    time_s: float
    frame: int
    type_mask: int
    velocity_m_s: tuple[float, float, float]
    yaw_rate_rad_s: float


@dataclass(frozen=True, slots=True)
class RecordedStep:
    """Motion over time, every array of shape (N,), and what was asked for.

    Attributes:
        name: of the recording.
        time_s: the autopilot's clock, from 0.
        velocity_m_s: (3, N), north, east, down.
        attitude_rad: (3, N), roll, pitch, yaw.
        yaw_rate_rad_s: about the body's down axis.
        height_m: above the autopilot's origin, 0 where a recording does not tell it.
        sent: the changes of the streamed setpoint; empty for a lost stream.
    """

    name: str
    time_s: Series
    velocity_m_s: Series
    attitude_rad: Series
    yaw_rate_rad_s: Series
    height_m: Series
    sent: tuple[SentSetpoint, ...]

    @classmethod
    def load(cls, path: Path) -> RecordedStep:
        """Read a CSV file with the columns `STEP_COLUMNS`, and z in metres if there is one.

        Raises:
            OSError: it cannot be read.
            KeyError: a column is missing.
            ValueError: there is no row, one that is too long, or something that is no number.
        """
        with path.open(newline="", encoding="utf-8-sig") as file:  # spreadsheets write a mark first
            rows = list(csv.DictReader(file))
        if not rows:
            raise ValueError("there are no rows under the heading")
        for number, row in enumerate(rows, 2):
            if None in row:
                raise ValueError(f"row {number} has more values than the heading has columns")
        columns = {key: np.array([float(row[key] or "nan") for row in rows]) for key in rows[0]}
        return cls(
            path.stem,
            columns["t_boot"] - columns["t_boot"][0],
            np.stack([columns[key] for key in ("vx", "vy", "vz")]),
            np.stack([columns[key] for key in _ANGLES]),
            columns["r"],
            -columns.get("z", np.zeros(len(rows))),
            _changes(columns),
        )

    @property
    def heading_velocity_m_s(self) -> Series:
        """Forward, right, down: shape (3, N)."""
        north, east, down = self.velocity_m_s
        cos_yaw, sin_yaw = np.cos(self.attitude_rad[2]), np.sin(self.attitude_rad[2])
        return np.stack([north * cos_yaw + east * sin_yaw, east * cos_yaw - north * sin_yaw, down])


def _changes(columns: dict[str, Series]) -> tuple[SentSetpoint, ...]:
    """Return each new setpoint; a row shows it if it was sent after the row before."""
    times = columns["t_boot"] - columns["t_boot"][0]
    before = np.concatenate([times[:1], times[:-1]]).tolist()
    sent: list[SentSetpoint] = []
    rows = zip(before, *(columns[key].tolist() for key in _SENT), strict=True)
    for sent_s, frame, mask, *numbers in rows:
        if math.isnan(frame):
            continue
        vx, vy, vz, yaw_rate = (0.0 if math.isnan(x) else x for x in numbers)
        new = SentSetpoint(sent_s, int(frame), int(mask), (vx, vy, vz), yaw_rate)
        if not sent or _differs(sent[-1], new):
            sent.append(new)
    return tuple(sent)


def _differs(a: SentSetpoint, b: SentSetpoint) -> bool:
    return a.velocity_m_s != b.velocity_m_s or a.yaw_rate_rad_s != b.yaw_rate_rad_s
