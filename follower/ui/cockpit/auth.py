"""Who may use the cockpit: by host name, origin and token."""

import ipaddress
import secrets
from collections.abc import Iterable, Mapping
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from urllib.parse import urlsplit

from follower.settings.ui import CockpitSettings
from follower_control.common.strict_config import SettingsError

_COOKIE = "follower_cockpit"
_LEAST_TOKEN = 12
_MOST_SESSIONS = 200
_LOCAL_NAMES = frozenset({"localhost"})


def token_for(settings: CockpitSettings) -> str | None:
    """Return the token to ask for: from its file, else a new one off loopback, else none.

    Raises:
        SettingsError: the file cannot be read or the token is too short.
    """
    if settings.token_file is None:
        return None if settings.on_loopback else secrets.token_urlsafe(18)
    try:
        lines = Path(settings.token_file).expanduser().read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"cockpit.token_file: cannot be read: {error}") from None
    token = lines[0].strip() if lines else ""
    if len(token) < _LEAST_TOKEN:
        raise SettingsError(
            f"cockpit.token_file: {settings.token_file}: its first line is to be a token of at "
            f"least {_LEAST_TOKEN} characters"
        )
    return token


class AccessControl:
    """Judges requests by their headers, whose names are in lower case.

    Args:
        token: that has to be known; None asks for none.
        names: host names of ours, beside localhost and addresses in numbers.
    """

    def __init__(self, token: str | None, names: Iterable[str] = ()) -> None:
        self._token = token
        self._names = _LOCAL_NAMES | {name.lower() for name in names}
        self._sessions: list[str] = []

    @property
    def needs_token(self) -> bool:
        """Whether there is one."""
        return self._token is not None

    def is_our_host(self, headers: Mapping[str, str]) -> bool:
        """Whether we were called by a name of ours.

        A web site that makes its own name point to this computer (DNS rebinding) cannot do so
        with an address in numbers.
        """
        host = _host_name(headers.get("host", ""))
        return host is not None and (host in self._names or _is_address(host))

    def is_our_origin(self, headers: Mapping[str, str]) -> bool:
        """Whether it comes from our own page, or from no page at all."""
        if headers.get("sec-fetch-site", "none") not in ("same-origin", "none"):
            return False
        origin = headers.get("origin")
        if origin is None:
            return True
        try:
            parts = urlsplit(origin)
        except ValueError:
            return False
        return parts.scheme in ("http", "https") and parts.netloc == headers.get("host")

    def session_of(self, headers: Mapping[str, str]) -> str | None:
        """Return the session of somebody who has shown the token before, None without one."""
        shown = _cookie(headers.get("cookie", ""), cookie_name(headers))
        return next((one for one in self._sessions if secrets.compare_digest(shown, one)), None)

    @staticmethod
    def shows_token(headers: Mapping[str, str]) -> bool:
        """Whether a token is shown with the request, be it right or wrong."""
        return headers.get("authorization", "").partition(" ")[0].lower() == "bearer"

    def is_token_right(self, headers: Mapping[str, str]) -> bool:
        """Whether the token that is shown with the request is the right one."""
        return self._is_token(headers.get("authorization", "").partition(" ")[2].strip())

    def open_session(self, token: str) -> str | None:
        """Return a new session's cookie for the right token, None for a wrong one."""
        if self._token is not None and not self._is_token(token):
            return None
        session = secrets.token_urlsafe(24)
        self._sessions = [*self._sessions, session][-_MOST_SESSIONS:]
        return session

    def _is_token(self, shown: str) -> bool:
        return secrets.compare_digest(shown.encode(), (self._token or "").encode())


def cookie_name(headers: Mapping[str, str]) -> str:
    """Return the name of the session's cookie: by the port that the browser called.

    Browsers send a host's cookies to all of its ports: those of one cockpit would shut out another.
    """
    port = headers.get("host", "").rpartition("]")[2].rpartition(":")[2]
    return f"{_COOKIE}_{port}" if port.isdecimal() else _COOKIE


def _host_name(host: str) -> str | None:
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def _cookie(text: str, name: str) -> str:
    try:
        found = SimpleCookie(text).get(name)
    except CookieError:
        return ""
    # compare_digest takes ASCII alone.
    return "" if found is None or not found.value.isascii() else found.value
