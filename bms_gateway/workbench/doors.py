"""Which requests are answered: those of this machine's browser, or of one that has shown the token, from our page.

The page reads files and starts work, so a foreign site that is open in the same browser must have no access. Requests
of such a site carry its own `Origin`. If the site lets a name of its own resolve to this machine (DNS rebinding), that
name is in `Host`.
"""

import secrets
import socket
import threading
from collections.abc import Iterable, Mapping
from ipaddress import IPv6Address, ip_address

HTTP = 80
LOOPBACK = ("127.0.0.1", "localhost", "::1")
SITES = ("same-origin", "none")
"""Values of `Sec-Fetch-Site` for our own page, and for an address that a person typed."""
TYPES = ("application/json", "application/octet-stream")
"""Allowed types of a body: a foreign page cannot send these without permission."""
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self'; form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
)
CLOSED = "this page needs the token that the program has printed: open that address; it is good for one browser"
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
}


WILDCARDS = ("0.0.0.0", "::", "")  # noqa: S104 - compared, not bound


class Door:
    """Names of the page, and which browsers have shown the token if other machines can reach the page.

    The printed address contains the token. The first browser that opens it gets a cookie; the token is then void, and
    there is another one for the next browser. HTTP is not encrypted: an eavesdropper can copy the cookie.

    Parameters
    ----------
    host : str
        As given by the user.
    address : str
        Address to which the server is bound.
    port : int
    more : iterable of str
        Other names of this machine, as NAME or NAME:PORT.
    """

    def __init__(self, host: str, address: str, port: int, more: Iterable[str] = ()) -> None:
        self.local = is_loopback(address)
        self._port, self._lock = port, threading.Lock()
        self._shown = own_address(address) if address in WILDCARDS else host
        others = () if self.local else (socket.gethostname(), self._shown)
        self.known = names(host, port).union(
            *(names(x, port) for x in others), (_with_port(x, port).lower() for x in more)
        )
        self._cookie = f"bms-gateway-{port}"  # browsers do not distinguish ports of a machine
        self._key, self._token = secrets.token_urlsafe(32), secrets.token_urlsafe(32)

    @property
    def url(self) -> str:
        """Address for a person; with the token if one is needed."""
        return f"http://{_with_port(self._shown, self._port)}/" + ("" if self.local else f"?token={self._token}")

    def refusal(self, method: str, headers: Mapping[str, str], reached: str) -> str:
        """Say why a request is refused, for every sender; empty if it is not.

        Parameters
        ----------
        method : str
        headers : mapping
            By lower-case name.
        reached : str
            Our own address on this connection. It is also one of our names: a foreign name that leads here is never a
            number.
        """
        plain = ip_address(reached.partition("%")[0])
        mapped = plain.ipv4_mapped if isinstance(plain, IPv6Address) else None
        return refusal(method, headers, self.known | names(str(mapped or plain), self._port))

    def admits(self, cookies: str) -> bool:
        """Whether a request with these cookies comes from this machine or from a browser that has shown the token."""
        mine = f"{self._cookie}={self._key}".encode()
        shown = (part.strip().encode("latin-1", "replace") for part in cookies.split(";"))
        return self.local or any(secrets.compare_digest(x, mine) for x in shown)

    def enter(self, token: str) -> str | None:
        """Use a token once; return the header with the cookie, None if the token is not the present one."""
        with self._lock:
            if not secrets.compare_digest(token.encode("utf-8", "replace"), self._token.encode()):
                return None
            self._token = secrets.token_urlsafe(32)
        return f"{self._cookie}={self._key}; Path=/; HttpOnly; SameSite=Strict"


def is_loopback(address: str) -> bool:
    """Whether an address is reachable from this machine only."""
    return ip_address(address.partition("%")[0]).is_loopback


def own_address(wildcard: str) -> str:
    """Return the address at which others reach this machine; its name if it has no network."""
    family, far = (socket.AF_INET6, "2001:db8::1") if ":" in wildcard else (socket.AF_INET, "192.0.2.1")
    with socket.socket(family, socket.SOCK_DGRAM) as way:
        try:
            way.connect((far, 9))  # nothing is sent: the kernel only chooses the route
        except OSError:
            return socket.gethostname()
        return str(way.getsockname()[0])


def names(host: str, port: int) -> frozenset[str]:
    """Return the values of `Host` for a server on this address.

    Examples
    --------
    >>> sorted(names("127.0.0.1", 8420))
    ['127.0.0.1:8420', '[::1]:8420', 'localhost:8420']
    """
    found = [_with_port(h, port) for h in {*LOOPBACK, host} - {*WILDCARDS}]
    if port == HTTP:  # browsers omit it
        found += [name.removesuffix(f":{HTTP}") for name in found]
    return frozenset(name.lower() for name in found)


def _with_port(name: str, port: int) -> str:
    """Write a name, or a numeric address, as browsers do; an existing port is kept."""
    if name.count(":") > 1 and not name.startswith("["):
        return f"[{name}]:{port}"
    return name if name.rpartition("]")[2].count(":") else f"{name}:{port}"


def refusal(method: str, headers: Mapping[str, str], known: frozenset[str]) -> str:
    """Say why a request is refused; empty if it is not.

    Parameters
    ----------
    method : str
    headers : mapping
        By lower-case name.
    known : frozenset of str
        From `names`.
    """
    host = headers.get("host", "").lower()
    if host not in known:
        return f"this page is not called '{host}'; it is at {', '.join(sorted(known))} (allow another name: --name)"
    origin = headers.get("origin", "").lower()
    if origin and origin.removeprefix("http://") not in known:
        return f"requests from {origin} are not answered"
    site = headers.get("sec-fetch-site", "none")
    if site not in SITES:
        return "requests from another site are not answered; type or paste the address into the browser"
    if method == "POST" and headers.get("content-type", "").partition(";")[0].strip() not in TYPES:
        return f"a body must be one of {', '.join(TYPES)}"
    return ""
