"""Errors of the paper's print and their corrections: one table for the terminal, this room's README, and tests."""

from dataclasses import dataclass

from bms_gateway.reproduce.result import Row, Section
from bms_gateway.reproduce.setting import Size


@dataclass(frozen=True, slots=True)
class Erratum:
    """One error of the print.

    Attributes
    ----------
    id, place : str
    printed, right : str
    why : str
    """

    id: str
    place: str
    printed: str
    right: str
    why: str


ERRATA = (
    Erratum("eq3", "Eq 3", "without a transpose", "(ΦᵀΦ)⁻¹Φᵀ Z", "Φ is tall: the product does not exist without it"),
    Erratum("eq4", "Eq 4", "rows otherwise", "rows φᵀ/m", "a row is a regressor, transposed and divided by m, as z is"),
    Erratum(
        "eq7",
        "Eq 7, 8",
        "no condition on the start",
        "needs T_c(0) = T_s(0) = T_f(0) and a coolant at rest",
        "otherwise a transient of about 3/λ; the filter's impulse response and sT_f as further regressors make it "
        "exact",
    ),
    Erratum("eq8", "after Eq 8", "the regressors in Eq 7", "those in Eq 8", "Eq 7 is not filtered yet"),
    Erratum(
        "eq9",
        "Eq 9",
        "the right root by a rough estimate",
        "smaller R_u iff R_u < C_c R_c/(C_c + C_s)",
        "both roots are positive and show the same surface; they meet at the fold, where nothing can be identified",
    ),
    Erratum(
        "capacities",
        "after Eq 9",
        "heat capacities only affect the transient",
        "true of the model, false of identification",
        "C_s presumed 10 % too large moves the core's rise by +39 %, 5 % too small leaves no root at all",
    ),
    Erratum("eq13", "Eq 13, B₁₁", "R_e R_c/C_c", "R_e/C_c", "heat over capacity; the print has the wrong unit"),
    Erratum(
        "eq15",
        "after Eq 15",
        "α₀ and α₁ the wrong way round",
        "least 0.005, greatest 0.3",
        "the lower bound is the smaller one",
    ),
    Erratum("eq16", "Eq 16", "two neighbours for every cell", "one for the first and the last", "nothing lies beyond"),
    Erratum("eq17", "Eq 17", "R_s", "R_u", "no other equation has an R_s"),
    Erratum(
        "eq18", "Eq 18, entry (3,4)", "another entry", "1/(R_c C_c)", "core 2 hears its own surface, as core 1 does"
    ),
    Erratum(
        "eq21",
        "Eq 21",
        "no capacities; 1/R_cc for 1/R_c; (6,2) without a factor",
        "rows over C_c and C_s; 1/R_c; (6,2) times 1 − 1/(R_u C_f)",
        "what reaches cell 3 from cell 1 has passed cell 2",
    ),
    Erratum(
        "ranks",
        "Table 2, 3, Fig 12, 13",
        "ranks in floating point",
        "one sensor is enough (without conduction: the last cell's)",
        "the counts change with the unit of time, which a rank cannot",
    ),
)

TEXT = (
    "What follows from the derivation and was checked by simulation. The equations in the code are the right-hand "
    "ones; each function names the equation it comes from.",
)


def section(size: Size) -> Section:  # noqa: ARG001 — nothing here is computed
    """List the errors of the print.

    References
    ----------
    Lin et al., throughout.
    """
    rows = tuple(Row(f"errata.{e.id}", e.place, e.printed, e.right, "paper wrong", e.why) for e in ERRATA)
    return Section("errata", "Errors of the print", TEXT, rows)
