"""Who may talk to the page: this machine's own browser, on a page of ours.

The page reads files and starts work, so a foreign site open in the same browser must reach nothing. Its requests carry
its own `Origin`; a name of its own that it lets resolve to 127.0.0.1 (DNS rebinding) stands in `Host`.
"""

from collections.abc import Mapping

LOOPBACK = ("127.0.0.1", "localhost", "::1")
SITES = ("same-origin", "none")
"""Values of `Sec-Fetch-Site` of our own page, and of an address that a person typed."""
TYPES = ("application/json", "application/octet-stream")
"""What a body may be: a foreign page cannot send these without asking first."""
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self'; form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
}


def names(host: str, port: int) -> frozenset[str]:
    """Give the values of `Host` by which a server on this address may be called.

    Examples
    --------
    >>> sorted(names("127.0.0.1", 8420))
    ['127.0.0.1:8420', '[::1]:8420', 'localhost:8420']
    """
    hosts = {*LOOPBACK, host} - {"0.0.0.0", "::", ""}  # noqa: S104 - compared, not bound
    return frozenset(f"[{h}]:{port}" if ":" in h else f"{h}:{port}" for h in hosts)


def refusal(method: str, headers: Mapping[str, str], known: frozenset[str]) -> str:
    """Say why a request is turned away; empty where it is not.

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
        return f"this page is not called '{host}'; it is at {', '.join(sorted(known))}"
    origin = headers.get("origin", "").lower()
    if origin and origin.removeprefix("http://") not in known:
        return f"requests from {origin} are not answered"
    site = headers.get("sec-fetch-site", "none")
    if site not in SITES:
        return "requests from another site are not answered"
    if method == "POST" and headers.get("content-type", "").partition(";")[0].strip() not in TYPES:
        return f"a body must be one of {', '.join(TYPES)}"
    return ""
