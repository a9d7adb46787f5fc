"""Parameters of the lumped core/surface model: meaning, units, bounds and priors.

Symbols are those of the paper (X. Lin et al., *Parameterization and Observability Analysis of Scalable Battery Clusters
for Onboard Thermal Management*). All numbers have SI units; temperatures are in °C, because the model uses only their
differences (K). Priors are log-normal, because resistances and capacities are positive and their errors are usually
stated in per cent.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

Condition = Literal["full", "natural", "no-conduction", "single"]
"""How the cells are coupled: coolant and conduction, conduction only, coolant only, neither."""
CONDITIONS: tuple[Condition, ...] = get_args(Condition)
Coolant = Literal["bulk", "ntu"]
"""Coolant path: the paper's bulk node (Eq 16) or the exact number-of-transfer-units exchange."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ParameterKind:
    """Meaning of one symbol.

    Attributes
    ----------
    symbol, description : str
    unit : str
        Unit shown to people; `to_si` times the shown number is SI.
    to_si : float
    lower, upper : float
        Physical bounds, SI: a value outside is refused, an estimate at a bound is not accepted.
    per_cell : bool
        May differ from cell to cell.
    """

    symbol: str
    description: str
    unit: str
    to_si: float
    lower: float
    upper: float
    per_cell: bool = True


# Bounds from a coin cell in still air to a 400 Ah prismatic cell under liquid; they detect wrong units (mΩ for Ω).
KINDS: Mapping[str, ParameterKind] = MappingProxyType(
    {
        k.symbol: k
        for k in (
            ParameterKind("C_c", "heat capacity of the core (jelly roll)", "J/K", 1.0, 1.0, 2e4),
            ParameterKind("C_s", "heat capacity of the surface (casing)", "J/K", 1.0, 0.1, 5e3),
            ParameterKind("R_e", "internal electrical resistance", "mOhm", 1e-3, 1e-5, 1.0),
            ParameterKind("R_c", "thermal resistance core to surface", "K/W", 1.0, 1e-2, 50.0),
            ParameterKind("R_u", "thermal resistance surface to coolant", "K/W", 1.0, 1e-2, 200.0),
            ParameterKind("R_cc", "thermal resistance cell to cell", "K/W", 1.0, 1e-2, 1e4, per_cell=False),
            ParameterKind("C_f", "heat-capacity flow of the coolant", "W/K", 1.0, 1e-2, 1e5, per_cell=False),
        )
    }
)
CELL_SYMBOLS = ("C_c", "C_s", "R_e", "R_c", "R_u")


@dataclass(frozen=True, slots=True)
class Prior:
    """Knowledge of one parameter before any data: log-normal about `value`.

    Attributes
    ----------
    value : float or ndarray (n,)
        Median, SI; an array holds one value per cell.
    rel_sd : float
        Standard deviation of the natural logarithm; 0 means known exactly (`fixed` in the model file).
    """

    value: float | Floats
    rel_sd: float = 0.0

    @property
    def fixed(self) -> bool:
        """Whether identification must keep the parameter at its value."""
        return self.rel_sd == 0.0


@dataclass(frozen=True, slots=True)
class StringParameters:
    """Numbers of one string of n cells; n = 1 is the single cell.

    Attributes
    ----------
    C_c, C_s, R_e, R_c, R_u : ndarray (n,)
        J/K, J/K, Ω, K/W, K/W per cell, in the order of the coolant path.
    R_cc : float
        K/W between neighbours; infinite if cells do not touch.
    C_f : float
        W/K of the coolant stream; infinite if the stream does not warm up along the string (ambient).
    coolant : {"bulk", "ntu"}
        Formula of the exchange between cell and stream.

    References
    ----------
    Lin et al., Table 1 (one cell), Eq 16–18 (R_cc and C_f).
    """

    C_c: Floats
    C_s: Floats
    R_e: Floats
    R_c: Floats
    R_u: Floats
    R_cc: float = np.inf
    C_f: float = np.inf
    coolant: Coolant = "bulk"

    @property
    def cells(self) -> int:
        """Number of cells n."""
        return int(self.C_c.shape[0])

    @classmethod
    def of(
        cls,
        cells: int,
        *,
        C_c: float | Floats,
        C_s: float | Floats,
        R_e: float | Floats,
        R_c: float | Floats,
        R_u: float | Floats,
        R_cc: float = np.inf,
        C_f: float = np.inf,
        coolant: Coolant = "bulk",
    ) -> "StringParameters":
        """Spread scalars over n cells.

        Examples
        --------
        >>> StringParameters.of(3, C_c=268, C_s=18.8, R_e=3.5e-3, R_c=1.266, R_u=0.79).R_e
        array([0.0035, 0.0035, 0.0035])
        """

        def spread(x: float | Floats) -> Floats:
            return np.array(np.broadcast_to(np.asarray(x, dtype=np.float64), (cells,)))

        return cls(spread(C_c), spread(C_s), spread(R_e), spread(R_c), spread(R_u), float(R_cc), float(C_f), coolant)

    def with_flow_ratio(self, ratio: float) -> "StringParameters":
        """Scale the stream to another coolant flow: C_f is proportional to it.

        R_u is not changed: its dependence on the flow is an effect of the catalogue (`flow_dependent_cooling`), which a
        model may have.

        Parameters
        ----------
        ratio : float
            Flow over nominal flow, > 0.
        """
        return replace(self, C_f=self.C_f * ratio)


# Differences that every pack has, which are no missing effect: relative sd of R_e, R_u, R_c of the cells; offsets in K.
DEFAULT_TOLERANCES: Mapping[str, float] = MappingProxyType(
    {"cell_R_e": 0.02, "cell_R_u": 0.02, "cell_R_c": 0.03, "surface_offset_K": 0.05, "inlet_offset_K": 0.05}
)


@dataclass(frozen=True, slots=True)
class Share:
    """A number between 0 and 1 and its sd; see `thermal.centre` for the two such numbers of a cell.

    Attributes
    ----------
    value, sd : float
    """

    value: float
    sd: float


@dataclass(frozen=True, slots=True)
class AddedEffect:
    """A physical effect of the catalogue that a model contains, with its numbers.

    Attributes
    ----------
    name : str
        Of the catalogue in `thermal.effects`.
    cell : int or None
        1-based, for an effect on one cell, on one thermocouple or on the stream after one cell.
    values : mapping of parameter to number, SI
    sd : mapping of parameter to number
        Standard deviation: SI, or of the logarithm for a parameter that is fitted as such; 0 means fixed.
    start : mapping of parameter to number, SI, or None
        Where every fit of these numbers starts; None if it starts from `values`.
    tied_with : tuple of str
        Effects of the catalogue that explain equally well the records by which this one was added.
    """

    name: str
    cell: int | None = None
    values: Mapping[str, float] = field(default_factory=dict)
    sd: Mapping[str, float] = field(default_factory=dict)
    start: Mapping[str, float] | None = None
    tied_with: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """The effect's name in model files and results: `name`, or `name:cell` if it is on one cell."""
        return self.name if self.cell is None else f"{self.name}:{self.cell}"

    @property
    def unfitted(self) -> "AddedEffect":
        """The effect with the start values of every fit."""
        return self if self.start is None else replace(self, values=self.start, start=None)


@dataclass(frozen=True, slots=True)
class Commissioning:
    """Result of a run that identified single cells, besides their values: sd and correlation of the numbers.

    Attributes
    ----------
    names : tuple of str
        `symbol:cell` (from 1) for a number of a cell, `symbol` for one of the string.
    rel_sd : ndarray (p,)
        Of the logarithms.
    correlation : ndarray (p, p)
        Symmetric, ones on the diagonal, positive definite.
    electrical : ndarray (n,), Ω
        Electrical resistance of each cell in that run; NaN if its voltage was not recorded.
    """

    names: tuple[str, ...]
    rel_sd: Floats
    correlation: Floats
    electrical: Floats


@dataclass(frozen=True, slots=True)
class Posterior:
    """Result of a fit to whole records, besides its numbers; their correlation is `StringModel.correlation`.

    Attributes
    ----------
    values, sd : mapping of name to float
        Of every fitted number, as in `StringModel.free_numbers`: if the rest of a model file differs, it was changed by
        hand.
    model_error_K : float
        Slow error of the surface that was assumed for the model; 0 if it explained the readings.
    core_doubt : float
        Additional share of the difference core to surface that may be wrong beyond the numbers' covariance. It is no
        number of the model: no surface reading can reduce it.
    calibrated : bool
        Whether a thermocouple in the core was used.
    not_proven : tuple of str
        Reasons against the core, a sentence each; empty if it is proven.
    """

    values: Mapping[str, float]
    sd: Mapping[str, float]
    model_error_K: float = 0.0
    core_doubt: float = 0.0
    calibrated: bool = False
    not_proven: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class StringModel:
    """One string as in its model file: structure, sensors and priors.

    Attributes
    ----------
    cells : int
    sensors : tuple of int
        Cells whose surface is measured, 1-based, ascending.
    condition : {"full", "natural", "no-conduction", "single"}
    priors : mapping of symbol to Prior
        C_c, C_s, R_e, R_c, R_u always; R_cc and C_f if the condition has them.
    coolant : {"bulk", "ntu"}
    capacity_Ah : float or None
        For state of charge by counting.
    flow : float or None
        Nominal coolant flow, m³/s, to which C_f belongs.
    tolerances : mapping
    effects : tuple of AddedEffect
        Parts of the model beyond I²R_e, two nodes and a coolant path.
    before : mapping of symbol to Prior, or None
        Priors before any data, if `priors` come from a fit.
    correlation : (names, ndarray (m, m)) or None
        Correlation of the errors of m numbers, by symbol or `effect key.parameter`: of the logarithm if a number is
        known in it. Other numbers are independent. Symmetric, ones on the diagonal, positive semidefinite.
    commissioning : Commissioning or None
        Present if single cells have been identified; their values are in `priors`.
    posterior : Posterior or None
        Present if `priors` come from a fit to whole records.
    centre_share, core_probe : Share or None
        Share of R_c within the roll, and position of a thermocouple in the core between the mean of the roll and its
        centre; None for the defaults of `thermal.centre`.
    cell_format : str or None
        Description of the cell for `thermal.cells.cell_of`: facts that no measurement can contradict.

    References
    ----------
    Lin et al., Table 1 for symbols; the conditions are those of Table 3.
    """

    cells: int
    sensors: tuple[int, ...]
    condition: Condition
    priors: Mapping[str, Prior]
    coolant: Coolant = "bulk"
    capacity_Ah: float | None = None
    flow: float | None = None
    tolerances: Mapping[str, float] = field(default_factory=lambda: DEFAULT_TOLERANCES)
    effects: tuple[AddedEffect, ...] = ()
    before: Mapping[str, Prior] | None = None
    correlation: tuple[tuple[str, ...], Floats] | None = None
    commissioning: Commissioning | None = None
    posterior: Posterior | None = None
    centre_share: Share | None = None
    core_probe: Share | None = None
    cell_format: str | None = None

    @property
    def doubts(self) -> tuple[str, ...]:
        """Reasons against the cores of this model, a sentence each: not proven while there is any."""
        return () if self.posterior is None else self.posterior.not_proven

    @property
    def core_doubt(self) -> float:
        """Additional share of the difference core to surface that may be wrong beyond the numbers' sd."""
        return 0.0 if self.posterior is None else self.posterior.core_doubt

    @property
    def free_numbers(self) -> tuple[Mapping[str, float], Mapping[str, float]]:
        """Value and sd of every number that is not fixed, by symbol or `effect key.parameter`.

        SI; the geometric mean if cells differ; the sd of the logarithm if a number is known in it.
        """
        values, sd = {}, {}
        for name, prior in self.priors.items():
            if not prior.fixed:
                one = np.ndim(prior.value) == 0
                values[name] = float(prior.value) if one else float(np.exp(np.mean(np.log(prior.value))))
                sd[name] = prior.rel_sd
        for e in self.effects:
            for name, spread in e.sd.items():
                if spread > 0.0:
                    values[f"{e.key}.{name}"], sd[f"{e.key}.{name}"] = e.values[name], spread
        return values, sd

    @property
    def unfitted(self) -> "StringModel":
        """The string as known before any data: every fit starts here, so that no data count twice."""
        if self.before is None:
            return self
        effects = tuple(e.unfitted for e in self.effects)
        known = replace(self, priors=self.before, before=None, effects=effects)
        return replace(known, correlation=None, commissioning=None, posterior=None)

    @property
    def has_conduction(self) -> bool:
        """Whether neighbours conduct heat to each other."""
        return self.cells > 1 and self.condition in ("full", "natural")

    @property
    def has_coolant_path(self) -> bool:
        """Whether the stream warms up from cell to cell."""
        return self.cells > 1 and self.condition in ("full", "no-conduction")

    @property
    def nominal(self) -> StringParameters:
        """The priors' medians as numbers of a string."""
        return self.parameters({})

    def parameters(self, values: Mapping[str, float | Floats]) -> StringParameters:
        """Numbers of the string: `values` (SI, by symbol) if given, otherwise the priors' medians."""
        v = {name: values.get(name, prior.value) for name, prior in self.priors.items()}
        return StringParameters.of(
            self.cells,
            C_c=v["C_c"],
            C_s=v["C_s"],
            R_e=v["R_e"],
            R_c=v["R_c"],
            R_u=v["R_u"],
            R_cc=float(v["R_cc"]) if self.has_conduction else np.inf,
            C_f=float(v["C_f"]) if self.has_coolant_path else np.inf,
            coolant=self.coolant,
        )
