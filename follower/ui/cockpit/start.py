"""Starts the station that a flight's settings and options ask for."""

import ssl
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from follower.settings.settings import Settings
from follower.settings.ui import CockpitSettings, VideoSettings
from follower.ui.cockpit.auth import token_for
from follower.ui.ipc.server_client import UiProcessClient
from follower.ui.terminal.console import check_extra
from follower_control.common.strict_config import SettingsError


def open_station(
    settings: Settings,
    cockpit: bool,
    page: dict[str, Any],
    runs: Path,
    say: Callable[[str], None],
) -> UiProcessClient | None:
    """Return a running station; None if neither video nor a page is wanted, which costs nothing.

    Args:
        settings: of the flight.
        cockpit: whether there is to be a page.
        page: what it is to know from the start.
        runs: folder with the flights that it lists.
        say: is shown each line for the user.

    Raises:
        SettingsError: the page needs what is not installed, or its token or certificate cannot be
            read.
    """
    if not cockpit and not settings.video.on:
        return None
    begin: dict[str, Any] = {
        "video": TypeAdapter(VideoSettings).dump_python(settings.video, mode="json"),
        "page": page,
        "runs": str(runs),
        "detector": settings.detector,
        "cockpit": None,
    }
    if cockpit:
        modules = "aiortc", "fastapi", "prometheus_client", "uvicorn", "websockets"
        check_extra("--cockpit", "cockpit", *modules)
        _check_certificate(settings.cockpit)
        wanted = TypeAdapter(CockpitSettings).dump_python(settings.cockpit, mode="json")
        begin |= {"cockpit": wanted, "token": token_for(settings.cockpit)}
    return UiProcessClient(begin, say)


def _no_password() -> str:
    """Refuse, where the program would ask on the terminal, at every start."""
    raise SettingsError(
        "cockpit.tls_key: it is encrypted, and nobody is there to give its password in flight: "
        "write it without one (openssl pkey -in KEY -out PLAIN_KEY) and let nobody else read it"
    )


def _check_certificate(settings: CockpitSettings) -> None:
    if settings.tls_cert is None:
        return
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        context.load_cert_chain(settings.tls_cert, settings.tls_key, _no_password)
    except OSError as error:
        raise SettingsError(
            f"cockpit.tls_cert, cockpit.tls_key: cannot be used: {error.strerror or error}"
        ) from None
