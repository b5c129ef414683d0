"""Makes the link that the settings ask for."""

from collections.abc import Callable
from functools import partial
from typing import Any

from follower.links.connections import ConnectionFailedError
from follower.links.link import Link
from follower.links.pymavlink_link import MavlinkLink
from follower.links.signing import Signer, SigningKey
from follower.settings.link import LINK_PLUGINS, LinkSettings
from follower_control.common.transport import Transport
from follower_vision.clock import Clock
from follower_vision.plugins import Plugin, PluginGuard

_PACKAGES_OWN = ("_receive", "_send_setpoint", "_send_fields")


def open_link(transport: Transport, settings: LinkSettings, clock: Clock, epoch_ns: int) -> Link:
    """Make a link over a transport that is open.

    Args:
        transport: carries the bytes; the link closes it.
        settings: which kind, which vehicle, which key.
        clock: the system's; mavsdk needs one that runs by itself.
        epoch_ns: the clock's time 0 in nanoseconds since 1970, UTC, for signing.

    Raises:
        ConnectionFailedError: the signing key or the library cannot be used.
        PluginError: another package's link cannot be used.
    """
    signer = None
    if settings.signing_key_file is not None:
        signer = Signer(SigningKey.from_file(settings.signing_key_file), epoch_ns)
    if settings.kind == "pymavlink":
        return MavlinkLink(transport, settings, signer)
    if settings.kind != "mavsdk" and (plugin := LINK_PLUGINS.find(settings.kind)) is not None:
        return _guarded(plugin.make(transport, settings, signer), plugin)
    try:
        from follower.links.mavsdk_link import MavsdkLink
    except ImportError as error:
        raise ConnectionFailedError(f"the mavsdk link cannot be used here: {error}") from error
    return MavsdkLink(transport, settings, signer, clock)


def _guarded(link: Link, plugin: Plugin) -> Link:
    """Make what fails in another package's link as good as silence, which the supervisor knows."""
    guard = PluginGuard(plugin, "it is silent")
    for name in _PACKAGES_OWN:
        setattr(link, name, partial(_run, guard, getattr(link, name)))
    return link


def _run(guard: PluginGuard, call: Callable[..., None], *arguments: Any) -> None:
    guard.run(partial(call, *arguments), None, lambda _: True)
