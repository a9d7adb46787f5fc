"""Every exception that the package raises on purpose.

::

    GatewayError                 one clear line: what, where, the nearest valid choice
    ├── UsageError               the caller's words: unknown command, option, name          fix the call
    ├── ConfigError              a file of the user: config, model, DBC                     fix the file
    ├── DataError                a log or table that cannot be read as what it claims to be fix the data
    ├── BusError                 the interface: missing, down, no permission                retry, or set it up
    ├── StateError               a stored state that must not be used (quarantined)         go on without it
    └── MissingExtraError        an optional package is absent                              install the extra

Bad data *from the bus* never raises: it becomes an event and a quality. A numerical outcome (not identifiable, folded)
is a value, not an exception.
"""

from collections.abc import Iterable
from difflib import get_close_matches

__all__ = [
    "BusError",
    "ConfigError",
    "DataError",
    "GatewayError",
    "MissingExtraError",
    "StateError",
    "UsageError",
    "did_you_mean",
]


class GatewayError(Exception):
    """Base of all; `str(e)` is the one line shown to the user, exit status 2."""


class UsageError(GatewayError):
    """The call itself is wrong; the caller mends it."""


class ConfigError(GatewayError):
    """A config, model or DBC file is wrong; the message names file, key and the nearest valid choice."""


class DataError(GatewayError):
    """A log or table is not what it claims to be; the message names file and line or column."""


class BusError(GatewayError):
    """The CAN interface cannot be used now; retrying may help."""


class StateError(GatewayError):
    """A stored state is corrupt, foreign or too new; it is set aside, the service goes on without it."""


class MissingExtraError(GatewayError):
    """A command needs an optional package.

    Parameters
    ----------
    what : str
        What was asked for, as the user calls it.
    extra : str
        Name of the extra that brings it.
    """

    def __init__(self, what: str, extra: str) -> None:
        super().__init__(f"{what} needs an optional package: pip install 'bms-gateway[{extra}]'")


def did_you_mean(word: str, choices: Iterable[str]) -> str:
    """Tell the nearest valid choice, as the end of an error line.

    Parameters
    ----------
    word : str
        What the user wrote.
    choices : iterable of str
        What would have been valid.

    Returns
    -------
    str
        ``"; did you mean 'x'?"``, or the list of the choices when none is near and they are few, or nothing.

    Examples
    --------
    >>> did_you_mean("chanel", ["channel", "interface"])
    "; did you mean 'channel'?"
    >>> did_you_mean("zzz", ["channel", "interface"])
    '; valid: channel, interface'
    """
    known = list(dict.fromkeys(choices))
    near = get_close_matches(word, known, n=1, cutoff=0.6)
    if near:
        return f"; did you mean '{near[0]}'?"
    return f"; valid: {', '.join(sorted(known))}" if 0 < len(known) <= 12 else ""
