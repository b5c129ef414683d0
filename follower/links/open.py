"""Makes the link that the settings ask for."""

from __future__ import annotations

from follower.links.autopilot_link import AutopilotLink
from follower.links.connection import ConnectionFailedError
from follower.links.link_settings import LinkSettings
from follower.links.mavlink import MavlinkLink
from follower.links.signing import Signer
from follower.links.signing_key import SigningKey
from follower_control.transport import Transport
from follower_vision.clock import Clock


def open_link(
    transport: Transport, settings: LinkSettings, clock: Clock, epoch_ns: int
) -> AutopilotLink:
    """Make a link over a transport that is open.

    Args:
        transport: carries the bytes; the link closes it.
        settings: which kind, which vehicle, which key.
        clock: the system's; mavsdk needs one that runs by itself.
        epoch_ns: the clock's time 0 in nanoseconds since 1970, UTC, for signing.

    Raises:
        ConnectionFailedError: the signing key or the library cannot be used.
    """
    signer = None
    if settings.signing_key_file is not None:
        signer = Signer(SigningKey.from_file(settings.signing_key_file), epoch_ns)
    if settings.kind == "pymavlink":
        return MavlinkLink(transport, settings, signer)
    try:
        from follower.links.mavsdk_link import MavsdkLink
    except ImportError as error:
        raise ConnectionFailedError(f"the mavsdk link cannot be used here: {error}") from error
    return MavsdkLink(transport, settings, signer, clock)
