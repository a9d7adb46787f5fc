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
from difflib import SequenceMatcher, get_close_matches

__all__ = [
    "BusError",
    "ConfigError",
    "DataError",
    "GatewayError",
    "MissingExtraError",
    "StateError",
    "UsageError",
    "clipped",
    "counted",
    "did_you_mean",
]


MOST_SHOWN = 1500
"""Characters of a line: names that a user made up stand in it."""


class GatewayError(Exception):
    """Base of all; `str(e)` is the one line shown to the user, exit status 2."""

    def __str__(self) -> str:
        return clipped(super().__str__(), MOST_SHOWN)


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


class OtherStatesError(StateError):
    """Stored temperatures are those of another form of the observer, as another version of the program has it."""


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


def clipped(text: str, most: int) -> str:
    """Shorten what may hold a user's own words, however many.

    Parameters
    ----------
    text : str
    most : int
        Characters, 40 at least.

    Examples
    --------
    >>> clipped("name: " + "x" * 100 + ": no such file", 40)
    'name: xxxxxxxxxxxxx … xxxx: no such file'
    """
    return text if len(text) <= most else f"{text[: most - 21]} … {text[-18:]}"


def signed(x: float, digits: int = 1) -> str:
    """Write a number with its sign, a true minus.

    Examples
    --------
    >>> signed(-12.24), signed(3.8), signed(-8.0, 0)
    ('−12.2', '+3.8', '−8')
    """
    return f"{x:+.{digits}f}".replace("-", "−")


def counted(count: int, one: str, many: str = "") -> str:
    """Write a count with its noun, singular or plural.

    Parameters
    ----------
    count : int
    one, many : str
        Singular and plural of the noun; without `many`, the plural is the singular with an s.

    Examples
    --------
    >>> counted(1, "row"), counted(0, "row"), counted(12, "row"), counted(2, "trajectory", "trajectories")
    ('1 row', '0 rows', '12 rows', '2 trajectories')
    """
    return f"{count} {one if count == 1 else many or one + 's'}"


MOST_DIGITS = 18
MOST_LISTED = 12
"""Number of valid choices up to which an error line lists them all."""
NEAREST = 3
"""Number of valid choices in an error line where there are more."""
MOST_COMPARED = 2000
"""Number of valid choices that are compared with a word: a DBC may have more names."""


def whole_number(text: str) -> int | None:
    """Read a whole number of a person's; None where it is none, or none that anything here could have.

    Examples
    --------
    >>> whole_number("12"), whole_number("-1"), whole_number("²"), whole_number("9" * 5000)
    (12, None, None, None)
    """
    return int(text) if text.isascii() and text.isdigit() and len(text) <= MOST_DIGITS else None


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
        ``"; did you mean 'x'?"``, or the list of the choices when none is near and they are few, or of many the
        `NEAREST` that are most like the word.

    Examples
    --------
    >>> did_you_mean("chanel", ["channel", "interface"])
    "; did you mean 'channel'?"
    >>> did_you_mean("lg_m51", ["lg_mj1", "lg_m50"])
    "; did you mean 'lg_m50'?"
    >>> did_you_mean("zzz", ["channel", "interface"])
    '; valid: channel, interface'
    >>> did_you_mean("zz7", [f"cell_{k}" for k in range(20)])
    '; of 20 valid ones the nearest: cell_7, cell_17, cell_0'
    """
    known = list(dict.fromkeys(choices))
    near = get_close_matches(word, known, n=5, cutoff=0.6)
    if near:
        # of equally near ones that which begins alike for longest: lg_m51 is meant for lg_m50, not for lg_mj1
        best = max(near, key=lambda x: (SequenceMatcher(None, word, x).ratio(), _alike(word, x)))
        return f"; did you mean '{best}'?"
    if len(known) <= MOST_LISTED:
        return f"; valid: {', '.join(sorted(known))}" if known else ""
    # equally near ones keep their order
    nearest = sorted(known[:MOST_COMPARED], key=lambda x: -SequenceMatcher(None, word, x).ratio())[:NEAREST]
    return f"; of {len(known)} valid ones the nearest: {', '.join(nearest)}"


def nearest_file(name: str, beside: Iterable[str]) -> str:
    """Name the nearest of the files `beside` one that does not exist, else those of its kind, as `did_you_mean`.

    Examples
    --------
    >>> nearest_file("bensh.csv", ["bench.csv", "cell.toml"])
    "; did you mean 'bench.csv'?"
    >>> nearest_file("x.csv", ["bench.csv", "cell.toml"])
    '; valid: bench.csv'
    """
    files = sorted(beside)
    near = get_close_matches(name, files, n=1)
    return did_you_mean(name, near or [x for x in files if x.rpartition(".")[2] == name.rpartition(".")[2]])


def _alike(a: str, b: str) -> int:
    """Count the letters with which both begin."""
    return next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))
