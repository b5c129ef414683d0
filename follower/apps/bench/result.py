"""What a bench has measured, as the JSON file in which it is kept and compared."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from follower_control.common.strict_config import SettingsError

_LEAST_ON_TARGET = 0.5
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class BenchSetup(_Record):
    """What is flown.

    Attributes:
        tracker: the motion tracker.
        detector: Fusion's; None is without one.
        device: where networks run.
        width: of the frames, in pixels.
        height: of the frames, in pixels.
        video: whether the recording has a video; the log is always recorded.
        camera_hz: the camera's rate; None is as many frames as vision can take.
    """

    tracker: str
    detector: str | None = None
    device: str = "cpu"
    width: int = Field(default=640, gt=0)
    height: int = Field(default=480, gt=0)
    video: bool = True
    camera_hz: Annotated[float, Field(gt=0)] | None = None

    @property
    def vision(self) -> tuple[str, str | None, str]:
        """What sees: tracker, detector and device."""
        return self.tracker, self.detector, self.device

    @property
    def size(self) -> str:
        """In words, e.g. "1280x720"."""
        return f"{self.width}x{self.height}"

    @property
    def name(self) -> str:
        """Of what sees, e.g. "nanotrack-v3 + yolox-nano, cuda"."""
        names = self.tracker if self.detector is None else f"{self.tracker} + {self.detector}"
        return names if self.device == "cpu" else f"{names}, {self.device}"


class BenchRow(BenchSetup):
    """What one set-up has reached.

    Attributes:
        frames: answered while it was measured.
        rate_hz: answers of vision a second.
        step_ms: median time that vision took for one.
        on_target: share of the answers that say "tracking" and cover the target (overlap above
            0.3).
        late_ms: how late control steps began: median.
        late_p99_ms: the same, in 99 of 100 steps at most.
        late_max_ms: the same, at most.
        period_off_p99_ms: how far the time between two steps was from the wanted one, in 99 of 100.
        control_ms: median time that a control step took.
        delay_ms: median time from a frame's capture to the end of the first control step that used
            it.
        sent: share of the control steps that sent a setpoint.
        cores: processor time of the whole program over the time.
        temperature_c: the hottest of the board's at the end, None if it does not tell.
        throttled: a Raspberry Pi's flags at the end, None elsewhere.
    """

    frames: int = Field(gt=0)
    rate_hz: Positive
    step_ms: Positive
    on_target: float = Field(ge=0, le=1)
    late_ms: NotNegative
    late_p99_ms: NotNegative
    late_max_ms: NotNegative
    period_off_p99_ms: NotNegative
    control_ms: Positive
    delay_ms: Positive
    sent: float = Field(ge=0, le=1)
    cores: Positive
    temperature_c: float | None = None
    throttled: int | None = None

    @property
    def lost(self) -> bool:
        """Whether the target was lost: what the figures then cost is not following."""
        return self.on_target < _LEAST_ON_TARGET


class BenchResult(_Record):
    """A bench of one computer.

    Attributes:
        kind: tells the file from others.
        name: of the board.
        note: who measured, and what else ran meanwhile.
        processor: the processor's model.
        cores: how many this program may use.
        memory_mb: all that there is.
        used_mb: the most that the program had of it, over all set-ups.
        load: processes that wanted to run before it began, a core; None if not known.
        versions: of what computes.
        rate_hz: of the camera that the advice is for.
        validate_every: frames between two of Fusion's detections.
        remarks: what was left out, and why.
        rows: in the order in which they were measured.
    """

    kind: Literal["follower bench"] = "follower bench"
    name: str
    note: str = ""
    processor: str
    cores: int = Field(gt=0)
    memory_mb: Positive
    used_mb: Positive
    load: NotNegative | None = None
    versions: dict[str, str] = Field(default_factory=dict)
    rate_hz: Positive = 30.0
    validate_every: int = Field(default=4, gt=0)
    remarks: tuple[str, ...] = ()
    rows: tuple[BenchRow, ...] = Field(min_length=1)

    def to_json(self) -> str:
        """Return the file's text."""
        return self.model_dump_json(indent=1) + "\n"

    @property
    def sizes(self) -> list[str]:
        """All sizes, smallest first."""
        by_size = {row.size: row.width * row.height for row in self.rows}
        return sorted(by_size, key=lambda size: by_size[size])


def read_bench(path: Path) -> BenchResult:
    """Read a bench's JSON file.

    Raises:
        SettingsError: it is missing, or something else.
    """
    try:
        return BenchResult.model_validate_json(path.read_bytes())
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror}") from None
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        where = ".".join(map(str, first["loc"]))
        why = f"{where}: {first['msg']}" if where else first["msg"]
        raise SettingsError(
            f"{path}: no file that `follower bench` has written ({why}); give its bench.json"
        ) from None
