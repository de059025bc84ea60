"""Where a request comes from, and how its connection learns that a person was recognised in it."""

from __future__ import annotations

import ipaddress
from collections.abc import Callable, Mapping
from typing import Any

RECOGNISED = "bench.recognised"
"""Extension of an ASGI scope: a function for the connection of the request."""
_IPV6_HOST_BITS = 64


def network(address: str) -> str:
    """What limits count by: an IPv4 address, the /64 of an IPv6 address, of which one host has as many as it likes."""
    try:
        found = ipaddress.ip_address(address)
    except ValueError:
        return address
    if isinstance(found, ipaddress.IPv4Address):
        return str(found)
    if found.ipv4_mapped:
        return str(found.ipv4_mapped)
    return str(ipaddress.ip_network((int(found), 128 - _IPV6_HOST_BITS), strict=False))


def recognised(scope: Mapping[str, Any], name: str) -> None:
    """Tell the connection of this request that it belongs to this person."""
    tell: Callable[[str], None] | None = scope.get("extensions", {}).get(RECOGNISED)
    if tell is not None:
        tell(name)
