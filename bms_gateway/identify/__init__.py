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


def build(method: str, model: StringModel, settings: Settings | None = None) -> Identifier:
    """Make the identifier that a string asks for.

    Parameters
    ----------
    method : {"window", "rls", "off"}
    model : StringModel
        One whose effects change more than the heat in the cores keeps its numbers, whatever the method: these know two
        nodes and I²R_e, and would take the effect for another resistance. See `window_effects`.
    settings : Settings or None
        Of the windowed method; the others have none.

    Raises
    ------
    ValueError
        Unknown method: the caller's mistake, as the config was checked before.

    References
    ----------
    Lin et al., Eq 3–9 for "rls"; "window" is ours.
    """
    if model.effects and method != "off":
        from bms_gateway.identify.window_effects import heat_only  # brings the catalogue along

        if method != "window" or not heat_only(model):
            return FixedIdentifier(model, FIXED_OFFLINE)
    if method == "window":
        return WindowIdentifier(model, settings)
    if method == "rls":
        from bms_gateway.identify.recursive import RecursiveIdentifier  # few strings ask for it

        return RecursiveIdentifier(model)
    if method == "off":
        return FixedIdentifier(model)
    raise ValueError(f"identify method {method!r}; valid: window, rls, off")
