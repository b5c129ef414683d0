"""Where the web cockpit is, and what its loss means."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

_LOOPBACK = ("127.0.0.1", "::1", "localhost")


@dataclass(frozen=True, slots=True)
class CockpitSettings:
    """The web page of `--cockpit`.

    Attributes:
        host: address to listen at. Off loopback a token is needed; the terminal shows it.
        port: to listen at; 0 takes a free one.
        names: host names by which the page may be called, beside localhost and addresses in
            numbers; others are refused, so that no foreign web site gets in by its own name.
        token_file: file whose first line is the token; None makes a new one for each flight.
        tls_cert: certificate (PEM) to speak https with; None speaks http.
        tls_key: its key (PEM).
        when_lost: "ignore" flies on without a page; "hold" follows only while a page has control,
            and holds, then lets go when it falls silent.
        lost_s: silence of the page in control that counts as lost.
        most_clients: that may be connected at once.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    host: str = "127.0.0.1"
    port: int = 8080
    names: tuple[str, ...] = ()
    token_file: str | None = None
    tls_cert: str | None = None
    tls_key: str | None = None
    when_lost: Literal["ignore", "hold"] = "ignore"
    lost_s: float = 2.0
    most_clients: int = 64

    def __post_init__(self) -> None:
        if not self.host.strip():
            raise ValueError("host is an address to listen at, such as 127.0.0.1 or 0.0.0.0")
        if not 0 <= self.port <= 65535:
            raise ValueError(f"port lies between 0 and 65535, not {self.port}")
        if (self.tls_cert is None) != (self.tls_key is None):
            raise ValueError("tls_cert and tls_key go together")
        if not 0.5 <= self.lost_s <= 60:
            raise ValueError(f"lost_s lies between 0.5 and 60 s, not {self.lost_s}")
        if not 1 <= self.most_clients <= 1000:
            raise ValueError(f"most_clients lies between 1 and 1000, not {self.most_clients}")

    @property
    def on_loopback(self) -> bool:
        """Whether nobody but this computer reaches it."""
        return self.host in _LOOPBACK

    @property
    def scheme(self) -> str:
        """What its address begins with."""
        return "http" if self.tls_cert is None else "https"
