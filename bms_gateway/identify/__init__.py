"""Parameters from measurements: the paper's regression as reference, windowed output error for the road."""

from bms_gateway.identify.contract import (
    FIXED_OFFLINE,
    Estimate,
    Identifier,
    Job,
    Posterior,
    Result,
    Tick,
    string_parameters,
)
from bms_gateway.identify.fixed import FixedIdentifier
from bms_gateway.identify.recursive import RecursiveIdentifier
from bms_gateway.identify.voltage import VoltageHeat, VoltageTracker
from bms_gateway.identify.window import Settings, WindowIdentifier
from bms_gateway.thermal import StringModel

__all__ = [
    "Estimate",
    "FixedIdentifier",
    "Identifier",
    "Job",
    "Posterior",
    "RecursiveIdentifier",
    "Result",
    "Settings",
    "Tick",
    "VoltageHeat",
    "VoltageTracker",
    "WindowIdentifier",
    "build",
    "string_parameters",
]


def build(method: str, model: StringModel, settings: Settings | None = None) -> Identifier:
    """Make the identifier that a string asks for.

    Parameters
    ----------
    method : {"window", "rls", "off"}
    model : StringModel
        One with effects keeps its numbers, whatever the method: these know I²R_e only, and would take an effect for
        another resistance.
    settings : Settings or None
        Of the windowed method; the others have none.

    Raises
    ------
    ValueError
        Unknown method: the caller's mistake, as the config was checked before.
    """
    if model.effects:
        return FixedIdentifier(model, FIXED_OFFLINE)
    if method == "window":
        return WindowIdentifier(model, settings)
    if method == "rls":
        return RecursiveIdentifier(model)
    if method == "off":
        return FixedIdentifier(model)
    raise ValueError(f"identify method {method!r}; valid: window, rls, off")
