"""How well the cores are known, as a number and in words: always the same for one model and the same records."""

from typing import Any

import numpy as np

from bms_gateway.diagnosis.compare import CoreCheck
from bms_gateway.diagnosis.core_band import BAND_SD
from bms_gateway.diagnosis.core_known import KnownCore
from bms_gateway.frames.quality import AVAILABLE_SD_K
from bms_gateway.report.show import number

NOT_PROVEN = "core not proven"
"""The state of a model in words, for tags and files."""
SEEN, USUAL = 0.5, 5.0
"""Per cent of the readings outside the band below which none is told, and up to which the band allows them."""
UNKNOWN_K = BAND_SD * AVAILABLE_SD_K
"""Half width of a 95 % band, K, beyond which a core is not given: the gateway sends such a core as not available."""
OUTSIDE = 0.1
"""Share of a core thermocouple's readings outside the 95 % band above which the band is wrong: twice the share that is
expected outside. The error of a model is nearly constant over minutes, so the share itself scatters."""


def core_document(core: KnownCore | None, otherwise: str = "") -> dict[str, Any]:
    """Return `core` of a JSON document.

    Parameters
    ----------
    core : KnownCore or None
        None if nothing can be learnt from the records; `otherwise` then says why.
    """
    if core is None:
        return {"proven": False, "sd_K": None, "centre_sd_K": None, "why": [otherwise]}
    return {"proven": core.proven, "sd_K": core.sd_K, "centre_sd_K": core.centre_sd_K, "why": list(core.why)}


def core_sentence(core: KnownCore) -> str:
    """Say in a sentence how well the cores are known, and whether that is proven."""
    half = core.half_width_K
    k = int(np.argmax(half))
    which = "the core" if len(half) == 1 else f"the core of cell {k + 1}, known least,"
    if core.proven:
        return f"By these records {which} is known to ± {number(half[k])} K (95 %), and nothing speaks against it."
    return f"{NOT_PROVEN.capitalize()}: {which} may be ± {number(half[k])} K off (95 %), or more."


def core_text(core: KnownCore) -> str:
    """Write this sentence, and below it the reasons why the core is not proven."""
    return "\n".join([core_sentence(core), *(f"  {why}" for why in core.why)])


def outside(check: CoreCheck) -> bool:
    """Whether a thermocouple in a core contradicts the band."""
    return 1.0 - check.covered > OUTSIDE


def thermocouple_sentence(check: CoreCheck) -> str:
    """Say how far the model is from a thermocouple in a core to which it was not fitted."""
    said = f"Thermocouple in the core of cell {check.cell}, never fitted to: {number(check.rmse_K)} K off"
    share = 100.0 * (1.0 - check.covered)
    if share < SEEN:
        return f"{said}, within the 95 % band."
    usual = ", as up to 5 % may" if share <= USUAL else ""
    return f"{said}; {share:.0f} % of its readings lie outside the 95 % band{usual}."
