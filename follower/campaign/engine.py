"""Where the runs of a campaign are flown: the seam for processes here and workers elsewhere."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Protocol

from follower.campaign.run_spec import RunSpec


class Engine(Protocol):
    """Flies runs, several at a time."""

    @property
    def workers(self) -> int:
        """How many at a time."""
        ...

    def fly(self, specs: Sequence[RunSpec]) -> Iterator[dict[str, Any]]:
        """Yield a row for each run as it is finished, in whatever order.

        A run that fails has a row that says why; it stops no other.
        """
        ...

    def close(self) -> None:
        """End what it has begun."""
        ...
