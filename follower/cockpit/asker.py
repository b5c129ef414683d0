"""As whom somebody who asks by HTTP is counted."""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from typing import Any

_IPV6_PREFIX = 64
"""Whoever has one IPv6 address has all of its network."""
_SESSION = "follower.session"


def address_of(scope: Mapping[str, Any]) -> str:
    """Return the network address that a request comes from; by IPv6 its whole network."""
    client = scope.get("client")
    return network_of(client[0]) if client else ""


def asker_of(scope: Mapping[str, Any]) -> str:
    """Return who asks: the session where there is one, else the address."""
    return str(scope.get(_SESSION) or address_of(scope))


def with_session(scope: Mapping[str, Any], session: str) -> dict[str, Any]:
    """Return a request that is known to belong to a session."""
    return {**scope, _SESSION: session}


def network_of(address: str) -> str:
    """Return what an address is counted as.

    An IPv4 address that was written as an IPv6 one is itself.
    """
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(found, ipaddress.IPv4Address):
        return str(found)
    if found.ipv4_mapped is not None:
        return str(found.ipv4_mapped)
    return str(ipaddress.ip_network((found, _IPV6_PREFIX), strict=False))
