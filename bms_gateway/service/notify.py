"""sd_notify: report the state of the service to systemd. Does nothing if systemd has not asked for it."""

import os
import socket
import time


def notify(*lines: str) -> bool:
    """Send assignments such as ``READY=1`` or ``STATUS=…``.

    Returns
    -------
    bool
        Whether a receiver exists.
    """
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return False
    if address.startswith("@"):
        address = "\0" + address[1:]
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sock:
        sock.setblocking(False)  # a busy PID 1 must not stop the service
        try:
            sock.sendto("\n".join(lines).encode(), address)
        except OSError:
            return False  # an error here is ignored: without WATCHDOG=1, systemd restarts the service, as it should
    return True


def reloading() -> bool:
    """Report that the configuration is being read again; ``READY=1`` ends this state."""
    return notify("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1_000}")


def watchdog_s() -> float | None:
    """Interval within which systemd wants ``WATCHDOG=1``, s; None if it does not watch this process."""
    if os.environ.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return None
    usec = os.environ.get("WATCHDOG_USEC", "")
    return int(usec) / 1e6 if usec.isdigit() and int(usec) > 0 else None
