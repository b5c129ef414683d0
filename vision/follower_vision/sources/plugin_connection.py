"""Cameras and streams of other packages, whose faults break a connection and nothing else."""

import math
from collections.abc import Iterator
from contextlib import contextmanager

from follower_vision.clock import Clock
from follower_vision.images.frame import Frame, Image
from follower_vision.plugins import Plugin, PluginError, PluginGroup, said
from follower_vision.sources.frame_source import SourceError

SOURCE_PLUGINS = PluginGroup("follower.sources", "source", ("rate_hz", "images", "close"))
"""Each makes a `Connection` when it is called with what follows "NAME:", and with the clock."""


class PluginConnection:
    """A `Connection` of another package; whatever it raises is a `SourceError`.

    Args:
        plugin: makes it.
        address: what follows the plug-in's name and a colon.
        clock: times the frames.

    Attributes:
        rate_hz: as the plug-in declares it, None if that is no rate.

    Raises:
        SourceError: it cannot be made.
    """

    def __init__(self, plugin: Plugin, address: str, clock: Clock) -> None:
        self._plugin = plugin
        with source_errors(plugin):
            self._connection = plugin.make(address, clock)
            rate = self._connection.rate_hz
            self.rate_hz = float(rate) if rate is not None and 0 < rate < math.inf else None

    def images(self) -> Iterator[tuple[Image, float]]:
        """See `Connection`."""
        with source_errors(self._plugin):
            for image, arrival_s in self._connection.images():
                if not math.isfinite(arrival_s):
                    raise SourceError(f"the {self._plugin} gives {arrival_s} as a frame's time")
                yield Frame(image, arrival_s, 0).image, arrival_s

    def close(self) -> None:
        """See `Connection`."""
        with source_errors(self._plugin):
            self._connection.close()


@contextmanager
def source_errors(plugin: Plugin) -> Iterator[None]:
    """Make a `SourceError`, which names the plug-in, of whatever is raised inside."""
    try:
        yield
    except SourceError:
        raise
    except Exception as error:  # the code of others; the source connects anew
        text = str(error) if isinstance(error, PluginError) else f"the {plugin}: {said(error)}"
        raise SourceError(text) from error
