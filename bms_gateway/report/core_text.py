"""Uncertainty of the cores, as a number and in words: always the same for one model and the same records."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from bms_gateway.diagnosis.core_band import BAND_SD, posterior
from bms_gateway.diagnosis.core_check import CoreCheck
from bms_gateway.diagnosis.core_known import KnownCore
from bms_gateway.diagnosis.error_words import half_width
from bms_gateway.diagnosis.together import cells_in_words
from bms_gateway.frames.quality import AVAILABLE_SD_K
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.report.show import number
from bms_gateway.report.words import in_words, parameters_labelled

NOT_PROVEN = "core not proven"
"""The state of a model in words, for tags and files."""
SEEN, USUAL = 0.5, 5.0
"""Per cent of the readings outside the band: below the first none is mentioned, up to the second the band allows
them."""
DOUBTFUL_NUMBERS = (
    "The readings ask for more than this model has. Its numbers make up for that, and each may be off by many times "
    "the sd that stands beside it."
)
EXCHANGED = (
    "This is not the wide band of a core about which nothing is known: it holds every share of the heat lost from "
    "casings and from cores that the readings and the capacities allow."
)
"""Remark on a band that is measured although the core is not proven; it may be narrower than before."""
CARRIED = (
    "The band is at least as wide as before what was added. Farthest from what was known is now {}: correct it in the "
    "file and begin again, or calibrate with a thermocouple in a core."
)
"""Remark on a core that stays unknown because its band is carried over (`KnownCore.carried`)."""
RESISTS: Final = "; an electrical resistance also changes with the temperature of its core"
WIDER: Final = 1.01
"""Posterior sd over prior sd from which a number is told to be wider than known before."""
UNKNOWN_K = BAND_SD * AVAILABLE_SD_K
"""Half width of a 95 % band, K, beyond which a core is not given: the gateway sends such a core as not available."""


def core_document(core: KnownCore | None, otherwise: str = "") -> dict[str, Any]:
    """Return `core` of a JSON document.

    Parameters
    ----------
    core : KnownCore or None
        None if nothing can be learnt from the records; `otherwise` then says why.
    """
    if core is None:
        return {"proven": False, "sd_K": None, "centre_sd_K": None, "why": [otherwise], "rests_on": None}
    said = rests_on(core.unseen, core.unlike) or None
    found = {"proven": core.proven, "sd_K": core.sd_K, "centre_sd_K": core.centre_sd_K, "why": list(core.why)}
    return {**found, "rests_on": said}


def core_sentence(core: KnownCore) -> str:
    """State in a sentence how well the cores are known, and whether this is proven."""
    half = core.half_width_K
    k = int(np.argmax(half))
    which = "the core" if len(half) == 1 else f"the core of cell {k + 1}, known least,"
    if core.proven:
        told = f"By these records {which} is known to ± {half_width(half[k])} K (95 %), and nothing speaks against it."
    else:
        told = f"{NOT_PROVEN.capitalize()}: {which} may be ± {half_width(half[k])} K off (95 %), or more."
        told += "" if core.exchanged is None else f" {EXCHANGED}"
        told += f" {CARRIED.format(parameters_labelled(core.carried))}" if core.carried and half[k] > UNKNOWN_K else ""
    return f"{told} {rests_on(core.unseen, core.unlike)}".rstrip()


def rests_on(unseen: Sequence[int], unlike: float) -> str:
    """State the assumption for the bands of cells without a thermocouple; empty if all cells have one.

    Parameters
    ----------
    unseen : sequence of int
        These cells, from 1.
    unlike : float
        Relative sd of R_e from cell to cell in their bands.

    Examples
    --------
    >>> rests_on((5,), 0.02)[:52]
    'Cell 5 has no thermocouple on the surface: its band '
    """
    if not unseen:
        return ""
    cells, have, their = cells_in_words(unseen), "have", "their bands hold"
    if len(unseen) == 1:
        have, their = "has", "its band holds"
    return (
        f"{cells[0].upper()}{cells[1:]} {have} no thermocouple on the surface: {their} only where R_e of all cells is "
        f"the same to within {number(100.0 * unlike, 0)} % (1 sd), as the model file says."
    )


def numbers_remark(core: KnownCore) -> str:
    """State the value of the numbers of a model that lacks something; empty without doubt about them."""
    if core.numbers_doubted:
        said = DOUBTFUL_NUMBERS
    elif error_K := core.identified.model_error_K:
        said = (
            f"The model was given an error of its own, {error_K:.2g} K over minutes: its numbers and their sd "
            "allow for what it lacks, as far as a surface can tell."
        )
    else:
        said = ""
    return f"{said} {wider_than_known(core.identified.fit)}".strip()


def wider_than_known(fit: MapFit) -> str:
    """Name the numbers that a fit leaves wider than they were known before, and why that is; empty without any."""
    sd = np.sqrt(np.diag(posterior(fit)))
    wide = [
        c.name
        for c, z in zip(fit.problem.coordinates, sd[: len(fit.problem.coordinates)].tolist(), strict=True)
        if not c.only_start and z > WIDER * c.sd
    ]
    if not wide:
        return ""
    these = ", ".join(wide[:-1]) + (" and " if wide[1:] else "") + wide[-1]
    said = "it, and it may" if len(wide) == 1 else "them, and they may"
    also = RESISTS if "R_e" in wide else ""
    return f"Wider than known before: {these}. These readings do not settle {said} have changed since then{also}."


def file_heading(said: str, core: KnownCore) -> str:
    """Write the heading of a model file: the doubts about its cores, a line each, and what `said` of its making."""
    why = [] if core.proven else [core_sentence(core), *(in_words(parameters_labelled(w)) for w in core.why)]
    return "\n".join([*why, said])


def core_text(core: KnownCore) -> str:
    """Write this sentence, and below it the reasons why the core is not proven."""
    return "\n".join([core_sentence(core), *(f"  {parameters_labelled(why)}" for why in core.why)])


def thermocouple_sentence(check: CoreCheck) -> str:
    """State the error of a model against a thermocouple in a core that was not fitted."""
    of = f" of {check.source.replace(chr(92), '/').rpartition('/')[2]}" if check.source else ""
    said = f"Thermocouple in the core of cell {check.cell}{of}, never fitted to: {number(check.rmse_K)} K off"
    share = 100.0 * (1.0 - check.covered)
    if share < SEEN:
        return f"{said}, within the 95 % band."
    usual = ", as up to 5 % may" if share <= USUAL else ""
    return f"{said}; {share:.0f} % of its readings lie outside the 95 % band{usual}."
