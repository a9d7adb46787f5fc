"""The address of a fleet's dashboard, to which the live page links; no data are fetched from it."""

import re
from typing import Final
from urllib.parse import urlsplit, urlunsplit

from bms_gateway.errors import UsageError

UID: Final = "bms-gateway"
"""Identifier of the dashboard that comes with the package."""
_DASHBOARD: Final = re.compile(r"/d/[\w-]+")


def dashboard_address(base: str) -> str:
    """Return the address of the dashboard, from the base address of a Grafana or from a dashboard's own address.

    The query is kept, such as `var-instance=truck_7:9105`.

    Raises
    ------
    UsageError

    Examples
    --------
    >>> dashboard_address("https://fleet.example/grafana/?orgId=2")
    'https://fleet.example/grafana/d/bms-gateway?orgId=2'
    >>> dashboard_address("http://localhost:3000/d/")
    'http://localhost:3000/d/bms-gateway'
    >>> dashboard_address("http://localhost:3000/d/mine/packs?var-instance=truck_7:9105")
    'http://localhost:3000/d/mine/packs?var-instance=truck_7:9105'
    """
    wrong = UsageError(f"workbench: --grafana {base!a}: expected an address such as https://grafana.example/")
    try:
        parts = urlsplit(base.strip())
        known = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        raise wrong from None
    if not known or not base.isprintable() or " " in base.strip():
        raise wrong
    if parts.username is not None:
        raise UsageError("workbench: --grafana: leave the user out of the address: every browser would see it")
    path = parts.path.rstrip("/").removesuffix("/d")
    path = path if _DASHBOARD.search(path) else f"{path}/d/{UID}"
    return urlunsplit((parts.scheme, parts.netloc, path, parts.query, ""))
