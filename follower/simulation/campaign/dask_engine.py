"""Flies runs on the workers of a Dask scheduler, on as many machines as it has."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from follower.campaign.extra import needed
from follower.campaign.flying import fly_run, row_of
from follower.campaign.local_engine import said_of
from follower.campaign.run_spec import RunSpec
from follower_control.strict_yaml import SettingsError

_CONNECT_S = 10
_RETRIES = 3


class DaskEngine:
    """A client of a running scheduler.

    Start `dask scheduler` on one machine and `dask worker ADDRESS --nthreads 1` on each, as often
    as it has cores; `follower` of the same version has to be installed there.

    Args:
        address: of the scheduler, e.g. "tcp://10.0.0.1:8786".

    Raises:
        SettingsError: nobody answers there, or no worker is there.
    """

    def __init__(self, address: str) -> None:
        self._dask = needed("distributed")
        try:
            self._client = self._dask.Client(address, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise SettingsError(
                f"--scheduler {address}: no scheduler answers ({said_of(error)}); start one with "
                "`dask scheduler`"
            ) from None
        if self.workers == 0:
            self._client.close()
            raise SettingsError(
                f"--scheduler {address}: it has no workers; start some with "
                f"`dask worker {address} --nthreads 1`"
            )

    @property
    def workers(self) -> int:
        """How many runs are flown at a time: the threads of all workers."""
        return sum(self._client.nthreads().values())

    def fly(self, specs: Sequence[RunSpec]) -> Iterator[dict[str, Any]]:
        """Yield a row for each run as it is finished.

        Dask flies what a dead worker had in hand on another one.
        """
        flying = {
            self._client.submit(fly_run, spec, pure=False, retries=_RETRIES): spec for spec in specs
        }
        for future in self._dask.as_completed(list(flying), loop=self._client.loop):
            spec = flying.pop(future)
            error = future.exception()
            yield row_of(spec, said_of(error)) if error else future.result()
            future.release()

    def close(self) -> None:
        """Leave the scheduler; what was not finished is not flown."""
        self._client.close()
