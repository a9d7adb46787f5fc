"""Parameters from measurements: the paper's regression as a reference, the windowed output-error fit for driving."""

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
from bms_gateway.identify.electrical import PairMeans
from bms_gateway.identify.fixed import FixedIdentifier
from bms_gateway.identify.ticks import Ticks
from bms_gateway.identify.voltage import VoltageHeat, VoltageTracker
from bms_gateway.identify.window import Settings, WindowIdentifier
from bms_gateway.thermal import StringModel

__all__ = [
    "Estimate",
    "FixedIdentifier",
    "Identifier",
    "Job",
    "PairMeans",
    "Posterior",
    "Result",
    "Settings",
    "Tick",
    "Ticks",
    "VoltageHeat",
    "VoltageTracker",
    "WindowIdentifier",
    "build",
    "string_parameters",
]


def build(method: str, model: StringModel) -> Identifier:
    """Make the identifier that a string asks for.

    Parameters
    ----------
    method : {"window", "rls", "off"}
    model : StringModel
        If its effects change more than the heat in the cores, its numbers are kept with every method: the methods know
        two nodes and I²R_e, and would mistake the effect for a change of resistance. See `window_effects`.

    Raises
    ------
    ValueError
        Unknown method: an error of the caller, because the configuration was checked before.

    References
    ----------
    Lin et al., Eq 3–9 for "rls"; "window" is not in the paper.
    """
    if model.effects and method != "off":
        from bms_gateway.identify.window_effects import heat_only  # brings the catalogue along

        if method != "window" or not heat_only(model):
            return FixedIdentifier(model, FIXED_OFFLINE)
    if method == "window":
        return WindowIdentifier(model)
    if method == "rls":
        from bms_gateway.identify.recursive import RecursiveIdentifier  # few strings ask for it

        return RecursiveIdentifier(model)
    if method == "off":
        return FixedIdentifier(model)
    raise ValueError(f"identify method {method!r}; valid: window, rls, off")
