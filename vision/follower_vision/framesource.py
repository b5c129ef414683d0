"""The seam for frame sources: where images come from."""

from __future__ import annotations

from types import TracebackType
from typing import Protocol, Self

from follower_vision.frame import Frame


class SourceError(ValueError):
    """A source gives no frames; the message says in one line what, where and what to do."""


class FrameSource(Protocol):
    """Gives frames one after the other; also a context manager that closes itself."""

    @property
    def nominal_rate_hz(self) -> float:
        """Frames a second as the source declares them; measure intervals, do not trust this."""
        ...

    @property
    def frame_count(self) -> int | None:
        """How many frames there are, as the source declares it; None if nobody knows."""
        ...

    @property
    def problem(self) -> str | None:
        """What went wrong so far, in one line, e.g. why a file ended early; None if nothing."""
        ...

    def read(self) -> Frame | None:
        """Return the next frame (a live source: the newest), or None at the end."""
        ...

    def close(self) -> None:
        """Release what the source holds; afterwards `read` returns None."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


class ClosesItself:
    """Makes a context manager of a class that has `close`."""

    def close(self) -> None:
        """Release what the source holds."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
