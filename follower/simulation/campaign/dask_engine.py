"""Flies runs on the workers of a Dask scheduler, on as many machines as it has."""

from collections.abc import Iterator, Sequence
from typing import Any

from follower.simulation.campaign.config import RunSpec
from follower.simulation.campaign.fly_run import fly_run, row_of
from follower.simulation.campaign.process_engine import describe_error
from follower.ui.terminal.console import needed
from follower_control.common.strict_config import SettingsError

_CONNECT_S = 10
_RETRIES = 3


class DaskEngine:
    """A client of a running scheduler.

    Start `dask scheduler` on one machine and `dask worker ADDRESS --nthreads 1` on each, as often
    as it has cores; `follower` of the same version has to be installed there.

    Args:
        address: of the scheduler, e.g. "tcp://10.0.0.1:8786".

    Raises:
        SettingsError: no scheduler answers there, or no worker is there.
    """

    def __init__(self, address: str) -> None:
        self._dask = needed("distributed")
        try:
            self._client = self._dask.Client(address, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise SettingsError(
                f"--scheduler {address}: no scheduler answers ({describe_error(error)}); start one "
                "with `dask scheduler`"
            ) from None
        if not self._client.nthreads():
            self._client.close()
            raise SettingsError(
                f"--scheduler {address}: it has no workers; start some with "
                f"`dask worker {address} --nthreads 1`"
            )

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
            yield row_of(spec, describe_error(error)) if error else future.result()
            future.release()

    def close(self) -> None:
        """Leave the scheduler; what was not finished is not flown."""
        self._client.close()
