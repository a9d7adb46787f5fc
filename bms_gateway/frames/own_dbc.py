"""Names in the DBC of the project itself, `bms_gateway.dbc`: input signals of strings, and sent messages."""

from bms_gateway.errors import ConfigError
from bms_gateway.frames.vocabulary import INPUTS, Quantity

__all__ = [
    "GATEWAY_STATUS",
    "MAX_CELLS",
    "MAX_STRINGS",
    "OWN_DBC",
    "input_messages",
    "own_signal",
    "string_message",
]

OWN_DBC = "bms_gateway.dbc"
MAX_STRINGS = 8
MAX_CELLS = 18
"""Capacity of the DBC; larger packs use their own DBC for the input."""

GATEWAY_STATUS = "gateway_status"


def own_signal(string_number: int, quantity: Quantity, cell: int | None = None) -> str:
    """Name of the input signal of one channel.

    Parameters
    ----------
    string_number : int
        1…8.
    quantity : Quantity
    cell : int, optional
        1…18, for an input of cells.

    Raises
    ------
    ConfigError
        The DBC does not contain the quantity, or has no room for that string or cell.

    Examples
    --------
    >>> own_signal(2, "surface", 7)
    'string_2_surface.surface_07'
    """
    _check_string(string_number)
    own = INPUTS[quantity].own
    if own is None:
        raise ConfigError(f"{OWN_DBC} has no signal for {quantity}; name a signal of your own DBC")
    if not INPUTS[quantity].of_cells:
        return own.format(k=string_number)
    if cell is None or not 1 <= cell <= MAX_CELLS:
        raise ConfigError(
            f"cell {cell}: {OWN_DBC} has signals for cells 1 to {MAX_CELLS}; name signals of your own DBC"
        )
    return own.format(k=string_number, c=cell)


def input_messages(string_number: int) -> tuple[str, ...]:
    """Messages of one string from a battery management system."""
    _check_string(string_number)
    signals = (i.own.format(k=string_number, c=1) for i in INPUTS.values() if i.own is not None)
    return tuple(dict.fromkeys(signal.split(".")[0] for signal in signals))


def string_message(string_number: int, name: str) -> str:
    """Name of a message of one string that our node sends, by its name in `engine/sent.py`.

    Examples
    --------
    >>> string_message(2, "core")
    'string_2_core'
    """
    return f"string_{string_number}_{name}"


def _check_string(number: int) -> None:
    if not 1 <= number <= MAX_STRINGS:
        raise ConfigError(
            f"string number {number}: {OWN_DBC} has strings 1 to {MAX_STRINGS}; name signals of your own DBC"
        )
