"""Names in the DBC of the project itself, `bms_gateway.dbc`: what a string's channels are called, what is sent."""

from bms_gateway.errors import ConfigError
from bms_gateway.frames.vocabulary import INPUTS, Quantity

__all__ = [
    "GATEWAY_INFO",
    "GATEWAY_STATUS",
    "MAX_CELLS",
    "MAX_STRINGS",
    "OWN_DBC",
    "PARAMETER_MUX",
    "core_message",
    "flags_message",
    "forecast_message",
    "growth_message",
    "health_message",
    "heat_message",
    "hottest_message",
    "input_messages",
    "own_signal",
    "parameters_message",
    "summary_message",
]

OWN_DBC = "bms_gateway.dbc"
MAX_STRINGS = 8
MAX_CELLS = 18
"""What the DBC has room for; larger packs bring their own DBC for the input."""

GATEWAY_STATUS = "gateway_status"
GATEWAY_INFO = "gateway_info"
PARAMETER_MUX = {"R_e": 0, "R_c": 1, "R_u": 2}
"""Multiplexer value of each parameter in `parameters_message`; the signals are NAME, NAME_sd and NAME_status."""


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
        The DBC does not carry the quantity, or has no room for that string or cell.

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
    """Messages that a battery management system sends of one string."""
    _check_string(string_number)
    signals = (i.own.format(k=string_number, c=1) for i in INPUTS.values() if i.own is not None)
    return tuple(dict.fromkeys(signal.split(".")[0] for signal in signals))


def core_message(string_number: int) -> str:
    """Message of core temperatures: multiplexer = cell, signals core_CC, core_sd_CC, surface_CC, quality_CC."""
    return f"string_{string_number}_core"


def summary_message(string_number: int) -> str:
    """Message with hottest_core, hottest_cell, hottest_sd, hottest_quality, coldest_core."""
    return f"string_{string_number}_summary"


def hottest_message(string_number: int) -> str:
    """Message with hottest_point, …_cell, …_sd, …_quality, …_core."""
    return f"string_{string_number}_hottest"


def parameters_message(string_number: int) -> str:
    """Message of parameters, multiplexed by `PARAMETER_MUX`."""
    return f"string_{string_number}_parameters"


def health_message(string_number: int) -> str:
    """Message with R_e_flag, R_e_growth, R_e_growth_sd, innovation, mismatch_flag."""
    return f"string_{string_number}_health"


def flags_message(string_number: int) -> str:
    """Message with ageing_flag, cooling_flag, thermocouple_flag and …_cell, R_u_growth, flags of what else is wrong."""
    return f"string_{string_number}_flags"


def growth_message(string_number: int) -> str:
    """Message of the ageing of single cells: multiplexer = cell, signals flag_CC, growth_CC, growth_sd_CC."""
    return f"string_{string_number}_growth"


def heat_message(string_number: int) -> str:
    """Message of heat that no current makes: multiplexer = cell, signals heat_flag_CC, heat_CC, heat_sd_CC."""
    return f"string_{string_number}_heat"


def forecast_message(string_number: int) -> str:
    """Message of the next ten minutes: mux 0 point_in_…, 1 point_sd_… and limit_…, 2 discharge_…, 3 charge_…."""
    return f"string_{string_number}_forecast"


def _check_string(number: int) -> None:
    if not 1 <= number <= MAX_STRINGS:
        raise ConfigError(
            f"string number {number}: {OWN_DBC} has strings 1 to {MAX_STRINGS}; name signals of your own DBC"
        )
