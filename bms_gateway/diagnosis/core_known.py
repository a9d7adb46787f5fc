"""How well records let the cores of a model be known, and whether that is proven: the one place that says either.

`compare`, `diagnose`, `add`, `fit`, the reports and the workbench all ask `known_core`, so that one model and one set
of records have one band. It depends on the model's structure, on what was known before any data, and on the records;
never on the command that asks.

A core is **proven** by records when nothing speaks against it, that is when all of these hold:

* the model file does not say otherwise: nothing was added by force, no witness of the search spoke against the core, no
  effect moved it by less than it is known to, and none was chosen among several that explain the records alike;
* the records can show an effect at all: none of the direct checks refuses them, and the rows of the current do not lie
  too far apart;
* the model explains the surfaces: no structure is left, and the error holds on held-out readings, both by the limits of
  `diagnose`. Where it does not, the model has an error of its own, and what that does in the core no surface tells;
* no effect of the catalogue passes the gates of `diagnose`: one that a model lacks can move its core and leave its
  surface as it is;
* no number ends at a bound, beyond `FAR` standard deviations of what was known of it, or against the cell's format.

After `fit --calibrate` a thermocouple in the core has testified: the third and fourth are then asked for only as far as
the model's own error exceeds `LARGE_K`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.diagnosis.calibrate import Identified, fitted_model, identify
from bms_gateway.diagnosis.checks import check_record
from bms_gateway.diagnosis.coarse_rows import HOPELESS, doubt, left_open
from bms_gateway.diagnosis.core_band import LUMPED, UNPROVEN, CoreBand, core_bands, half_width_K, posterior, typical_K
from bms_gateway.diagnosis.geometry import odd_fitted
from bms_gateway.diagnosis.misfit import nearest, sensors
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.record import Record
from bms_gateway.diagnosis.residuals import unexplained
from bms_gateway.diagnosis.search import search
from bms_gateway.diagnosis.weighing import Settings, Trial
from bms_gateway.identify.coordinates import Coordinate
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.thermal import KINDS, Floats, StringModel
from bms_gateway.thermal.centre import probe_lever
from bms_gateway.thermal.effects import effect_named

FAR = 3.0
"""sd of what was known of a number, beyond which it is not believed: one in four hundred."""
LARGE_K = 0.3
"""Slow error of a model at the surface, from which not even a calibrated core is believed: it is that of a weak effect,
and R_c/R_u of it goes into the core."""
ONE = Settings(effects=1, ways=0)
"""Of the search: only whether there is an effect to be named."""


@dataclass(frozen=True, slots=True)
class KnownCore:
    """Cores of a model by records.

    Attributes
    ----------
    identified : Identified
        The fit that they are taken from.
    bands : tuple of CoreBand, one per record
    why : tuple of str
        What speaks against the core, a sentence each; empty where it is proven.
    """

    identified: Identified
    bands: tuple[CoreBand, ...]
    why: tuple[str, ...]

    @property
    def proven(self) -> bool:
        """Whether nothing speaks against the core."""
        return not self.why

    @property
    def cell_sd_K(self) -> Floats:
        """Standard deviation of each cell's core (n,), root mean square over all records, K."""
        return typical_K([b.total_K for b in self.bands])

    @property
    def sd_K(self) -> float:
        """The same of the cell that is known least: the one number for a string."""
        return float(self.cell_sd_K.max())

    @property
    def centre_sd_K(self) -> float:
        """Standard deviation of the hottest point that is known least, root mean square over all records."""
        return float(typical_K([b.centre_sd_K for b in self.bands]).max())

    @property
    def half_width_K(self) -> Floats:
        """95 % half width of each cell's core (n,), K."""
        return half_width_K(self.bands)

    def widened(self, share: float) -> "KnownCore":
        """Hold at least this share of the difference core to surface for possibly wrong."""
        bands = tuple(replace(b, share=max(b.share, share)) for b in self.bands)
        return replace(self, bands=bands)

    def share_for(self, before: "KnownCore") -> float:
        """Least share, to four digits, with which no cell's band is narrower than another model's on these records."""
        wanted = before.cell_sd_K**2
        rest = typical_K([np.hypot(b.sd_K, b.remainder_K) for b in self.bands]) ** 2
        lever = typical_K([b.lever_K for b in self.bands]) ** 2
        share = float(np.sqrt(np.max(np.maximum(wanted - rest, 0.0) / np.maximum(lever, 1e-12))))
        return float(np.ceil(1e4 * share) / 1e4)


def known_core(
    model: StringModel,
    records: Sequence[Record],
    identified: Identified | None = None,
    rounds: Sequence[Sequence[Trial]] | None = None,
) -> KnownCore:
    """Tell how well records let the cores of a model be known, and whether that is proven.

    Parameters
    ----------
    model : StringModel
        Fitted from what was known before any data; its `doubts` count as they are.
    records : sequence of Record
    identified : Identified, optional
        By `identify`, of this model and these records without thermocouples in cores: spares the fit.
    rounds : sequence of sequence of Trial, optional
        Of a search for what this model, as it was before any data, lacks in these records: spares the first of them.

    Returns
    -------
    KnownCore
        The same for the same model and records, to the last bit, whatever is spared.

    Notes
    -----
    Costs a fit and, where that explains the surfaces, the first round of the search: as much as a diagnosis that finds
    nothing.
    """
    fitted = identify(model, records) if identified is None else identified
    why = tuple(dict.fromkeys([*model.doubts, *_against(model, records, fitted, rounds)]))
    return KnownCore(fitted, bands_of(fitted, UNPROVEN if why else LUMPED), why).widened(model.core_doubt)


def judged_model(
    fit: MapFit,
    model: StringModel,
    records: Sequence[Record],
    said: Sequence[str] = (),
    *,
    calibrated: bool = False,
    identified: Identified | None = None,
    before: KnownCore | None = None,
) -> tuple[StringModel, KnownCore]:
    """Return the model with the numbers of a fit as it is written, and what these records make of its cores.

    Parameters
    ----------
    fit : MapFit
    model : StringModel
        What it was.
    records : sequence of Record
    said : sequence of str
        What is held against its cores already.
    calibrated : bool
        The fit has seen cores.
    identified : Identified, optional
        As `known_core` takes it.
    before : KnownCore, optional
        Than which the band must not be narrower where it is not proven.
    """
    core = known_core(fitted_model(fit, model, calibrated=calibrated, not_proven=said), records, identified)
    share = 0.0 if core.proven else max(UNPROVEN, core.share_for(before) if before else 0.0)
    if calibrated:  # the thermocouple may sit nearer to the centre or to the mean than the fit took it to
        lever = probe_lever(model)
        share = max(share, lever.sd / (1.0 + lever.value))
    error = core.identified.model_error_K
    written = fitted_model(fit, model, calibrated=calibrated, doubt=share, model_error_K=error, not_proven=core.why)
    return written, core.widened(share)


def bands_of(found: Identified, share: float) -> tuple[CoreBand, ...]:
    """State the cores of each record by a fit, whose slow error at the surface is told or what it was given."""
    n = found.stated.problem.model.cells
    left = [max(s, found.model_error_K) for s in nearest(sensors(found.stated), n)]
    return core_bands(found.stated, left, covariance=posterior(found.fit), share=share)


def _against(
    model: StringModel,
    records: Sequence[Record],
    fitted: Identified,
    rounds: Sequence[Sequence[Trial]] | None,
) -> list[str]:
    said = [f"{r.source}: {f.sentence}" for r in records for f in check_record(r, model) if f.severity == "stop"]
    doubts = [doubt(r) for r in records]
    if max(doubts) > HOPELESS:
        said.append("The rows of the current lie too far apart to know the heat between them.")
    calibrated = model.posterior is not None and model.posterior.calibrated
    if calibrated and fitted.model_error_K <= LARGE_K:
        return said + numbers_far(fitted.fit)
    own = f": it needs an error of its own of {fitted.model_error_K:.2g} K" if fitted.model_error_K else ""
    structured, fails_held = unexplained(fitted.plain, left_open(fitted.plain, doubts))
    if structured or fails_held:
        where = "the surfaces" if structured else "readings that were held out"
        said.append(f"The model does not explain {where}{own}.")
    elif lacks := _lacking(model, records, doubts, rounds):
        said.append(lacks)
    return said + numbers_far(fitted.fit)


def _lacking(
    model: StringModel, records: Sequence[Record], doubts: Sequence[float], rounds: Sequence[Sequence[Trial]] | None
) -> str:
    """Say what a model that explains the surfaces lacks all the same; empty where it is nothing of the catalogue."""
    if rounds is None:
        start = model.unfitted
        rounds = search(start, [measured(r, start) for r in records], ONE, doubts=doubts).rounds
    trials = rounds[0] if rounds else []
    named = next((t.candidate.key for t in trials if t.passed), None)
    if named is not None:
        return f"These records ask for {named}, which the model lacks."
    if any(t.log_odds > ONE.ahead for t in trials):
        return "These records lack something that no single effect of the catalogue explains."
    return ""


def numbers_far(fit: MapFit) -> list[str]:
    """Name the numbers of a fit that end at a bound, far from what was known of them, or against the cell's format."""
    said = []
    for c, z in zip(fit.problem.coordinates, fit.theta.tolist(), strict=True):
        if c.only_start:
            continue
        off = (z - c.prior) / c.sd
        if fit.at_bound(c.name) and not _vanished(c, z):
            said.append(f"{c.name} ends at its bound.")
        elif abs(off) > FAR:
            said.append(f"{c.name} ends {abs(off):.1f} sd from what was known of it.")
    return said + [odd.says for odd in odd_fitted(fit)]


def _vanished(c: Coordinate, z: float) -> bool:
    """Whether an effect's number has ended where the effect is none, or all of a share: no sign of trouble."""
    if c.effect is None:
        return c.name.partition("@")[0] not in KINDS
    p = effect_named(c.effect.partition(":")[0]).parameter(c.name.rpartition(".")[2])
    return p.neutral is None or (float(np.exp(z)) if p.log else z) == p.neutral
