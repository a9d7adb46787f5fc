"""How well records determine the cores of a model, and whether the cores are proven; no other module decides this.

`compare`, `diagnose`, `add`, `fit`, the reports and the workbench all call `known_core`, so that one model and one set
of records have one band. It depends on the model's structure, its priors before any data, and the records, and never on
the command.

A core is **proven** by records if all of these hold:

* the model file does not deny it: nothing was added by force, no witness of the search contradicted the core, no effect
  moved the core by less than its band, and none was chosen among several that explain the records equally well;
* the records can show an effect at all: none of the direct checks refuses them, and the rows of the current are not too
  far apart;
* the model explains the surfaces: no structure is left, and the error stays small on held-out readings, both by the
  limits of `diagnose`. Otherwise there is a model error, whose effect on the core no surface shows;
* no effect of the catalogue passes the gates of `diagnose`: a missing effect can move the core without a change of
  the surface;
* no effect of the model looks at every surface like another one that leads to a different core (`Effect.elsewhere`);
* no number ends at a bound, beyond `FAR` standard deviations from its prior, or against the cell's format;
* no thermocouple in a core contradicts the band (`core_check`). No fit and no choice of effects uses its readings.

After `fit --calibrate`, a thermocouple in the core has confirmed the core: the third and fourth condition are then
checked only if the model error exceeds `LARGE_K`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.diagnosis.along_coolant import coolant_doubts
from bms_gateway.diagnosis.calibrate import Identified, fitted_model, identify
from bms_gateway.diagnosis.checks import check_record
from bms_gateway.diagnosis.coarse_rows import HOPELESS, doubt, left_open
from bms_gateway.diagnosis.core_band import LUMPED, UNPROVEN, CoreBand, core_bands, half_width_K, typical_K
from bms_gateway.diagnosis.core_check import CONTRADICTED, contradiction, core_checks
from bms_gateway.diagnosis.exchange import exchanged_share
from bms_gateway.diagnosis.geometry import odd_fitted
from bms_gateway.diagnosis.misfit import nearest, sensors
from bms_gateway.diagnosis.record import Record
from bms_gateway.diagnosis.residuals import unexplained
from bms_gateway.diagnosis.search import Search, search
from bms_gateway.diagnosis.verdict_parts import errors
from bms_gateway.diagnosis.verdict_words import BY_NUMBERS
from bms_gateway.diagnosis.wandering import more_than_rows, rows_are_open, rows_may_matter
from bms_gateway.diagnosis.weighing import Settings, Trial
from bms_gateway.identify.coordinates import Coordinate
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.thermal import KINDS, Floats, StringModel
from bms_gateway.thermal.centre import probe_lever
from bms_gateway.thermal.effects import effect_named

FAR = 3.0
"""Distance of a number from its prior, in sd of the prior, above which it is not plausible: one in four hundred."""
LARGE_K = 0.3
"""Model error at the surface above which not even a calibrated core counts as proven: that of a weak effect, multiplied
by R_c/R_u in the core."""
ONE = Settings(effects=1, ways=0)
"""Settings of the search: only to find whether any effect can be named."""
LACKS_UNKNOWN = "These records lack something that no single effect of the catalogue explains."


@dataclass(frozen=True, slots=True)
class KnownCore:
    """Cores of a model, as determined by some records.

    Attributes
    ----------
    identified : Identified
        The fit of these cores.
    bands : tuple of CoreBand, one per record
    why : tuple of str
        Reasons why the core is not proven, a sentence each; empty if it is proven.
    lacks : bool
        Whether the readings show that the model lacks something.
    exchanged : float or None
        Share of core minus surface that may be wrong because heat leaves elsewhere (`exchange`), if this is the only
        doubt about the core and is known; the bands contain it.
    """

    identified: Identified
    bands: tuple[CoreBand, ...]
    why: tuple[str, ...]
    lacks: bool = False
    exchanged: float | None = None

    @property
    def proven(self) -> bool:
        """Whether the core is proven."""
        return not self.why

    @property
    def numbers_doubted(self) -> bool:
        """Whether the numbers also represent missing effects, and their sd do not allow for it.

        In a fit with a model error, the sd allow for it.
        """
        return self.lacks and self.identified.model_error_K == 0.0

    @property
    def cell_sd_K(self) -> Floats:
        """Standard deviation of each cell's core (n,), root mean square over all records, K."""
        return typical_K([b.total_K for b in self.bands])

    @property
    def sd_K(self) -> float:
        """The same for the least certain cell: one number for a string."""
        return float(self.cell_sd_K.max())

    @property
    def centre_sd_K(self) -> float:
        """Standard deviation of the least certain hottest point, root mean square over all records."""
        return float(typical_K([b.centre_sd_K for b in self.bands]).max())

    @property
    def half_width_K(self) -> Floats:
        """95 % half width of each cell's core (n,), K."""
        return half_width_K(self.bands)

    @property
    def unseen(self) -> tuple[int, ...]:
        """Cells, from 1, whose surface no record has: their cores follow from those of the other cells."""
        return unseen(self.identified.fit)

    @property
    def unlike(self) -> float:
        """Relative sd of R_e from cell to cell that the band of an unseen cell assumes."""
        return unlike(self.identified.fit)

    def widened(self, share: float) -> "KnownCore":
        """Assume that at least this share of core minus surface may be wrong."""
        bands = tuple(replace(b, share=max(b.share, share)) for b in self.bands)
        return replace(self, bands=bands)

    @property
    def for_its_numbers(self) -> bool:
        """Whether all that speaks against the core is how far numbers of a model that lacks nothing are from known."""
        speak = {*numbers_far(self.identified.fit), *coolant_doubts(self.identified.closest)}
        return not self.lacks and bool(self.why) and set(self.why) <= speak

    @property
    def carried(self) -> str:
        """Symbol of the number that is farthest from what was known, if the band is that of an earlier model.

        More than the whole difference of core and surface is then called open, which no fit gives. Otherwise empty.
        """
        wide = max(b.share for b in self.bands) > 1.0
        return farthest(self.identified.fit) if wide and self.why and self.exchanged is None else ""

    @property
    def at_closest(self) -> "KnownCore":
        """The cores by the numbers that come closest to the surfaces, where those that are stated are far from them.

        What other numbers of the same model remove is an error of numbers and not of the model. The share that may be
        wrong is kept.
        """
        near = errors(self.identified.closest).train_rmse_K < BY_NUMBERS * errors(self.identified.fit).train_rmse_K
        if not near:
            return self
        share = max(UNPROVEN, *(b.share for b in self.bands))
        return replace(self, bands=bands_of(replace(self.identified, fit=self.identified.closest), share))

    def share_for(self, before: "KnownCore") -> float:
        """Find the least share, to four digits, with which no cell's band is narrower than that of another model.

        A model that lacks nothing, as far as the readings tell, has found numbers of its own. An error which the other
        model owes to its numbers says nothing about its core then (`at_closest`).
        """
        limits = [before, *([before.at_closest] if self.for_its_numbers else [])]
        wanted = np.min([x.cell_sd_K for x in limits], axis=0) ** 2
        rest = typical_K([np.hypot(b.sd_K, b.remainder_K) for b in self.bands]) ** 2
        lever = typical_K([b.lever_K for b in self.bands]) ** 2
        share = float(np.sqrt(np.max(np.maximum(wanted - rest, 0.0) / np.maximum(lever, 1e-12))))
        return float(np.ceil(1e4 * share) / 1e4)


def unseen(fit: MapFit) -> tuple[int, ...]:
    """List the cells, from 1, whose surface none of a fit's records has."""
    seen = {k for m in fit.problem.records for _, k in m.channels}
    return tuple(k for k in range(1, fit.problem.model.cells + 1) if k not in seen)


def unlike(fit: MapFit) -> float:
    """Return the relative sd of R_e from cell to cell in a fit's model."""
    return fit.problem.model.tolerances.get("cell_R_e", 0.0)


def known_core(
    model: StringModel,
    records: Sequence[Record],
    identified: Identified | None = None,
    searched: Search | None = None,
) -> KnownCore:
    """Compute how well records determine the cores of a model, and whether the cores are proven.

    Parameters
    ----------
    model : StringModel
        The model; the fit starts from its numbers before any data, and its `doubts` are kept.
    records : sequence of Record
    identified : Identified, optional
        Result of `identify` for this model and these records, without thermocouples in cores; it replaces the fit.
    searched : Search, optional
        Search of `diagnose` for the effects that this model, before any data, lacks in these records; it replaces the
        one that is made here.

    Returns
    -------
    KnownCore
        The same for the same model and records, to the last bit, for any optional arguments.

    Notes
    -----
    It costs a fit and, if this explains the surfaces, the first round of the search: as much as a diagnosis that finds
    nothing.
    """
    fitted = identify(model, records) if identified is None else identified
    doubts = [doubt(r) for r in records]
    calibrated = model.posterior is not None and model.posterior.calibrated
    confirmed = calibrated and fitted.model_error_K <= LARGE_K
    lacks = [] if confirmed else _lacks(fitted, records, doubts, searched)
    said = [*_unusable(model, records, doubts), *lacks, *numbers_far(fitted.fit)]
    said += coolant_doubts(fitted.closest) if said else ()  # alone it is no reason: the cooling of cells may differ
    elsewhere = [] if calibrated else _elsewhere(model)
    why = tuple(dict.fromkeys([*model.doubts, *said, *elsewhere]))
    share = exchanged_share(fitted, records) if why and set(why) <= set(_elsewhere(model)) else None
    assumed = LUMPED if not why else UNPROVEN if share is None else max(LUMPED, share)
    core = KnownCore(fitted, bands_of(fitted, assumed), why, bool(lacks), share).widened(model.core_doubt)
    return _held_against(core, records)


def judged_model(
    found: Identified,
    model: StringModel,
    records: Sequence[Record],
    said: Sequence[str] = (),
    *,
    calibrated: bool = False,
    before: KnownCore | None = None,
) -> tuple[StringModel, KnownCore]:
    """Return the model with the numbers of a fit, as it is written, and its cores as these records determine them.

    Parameters
    ----------
    found : Identified
        The fit.
    model : StringModel
        The model before the fit.
    records : sequence of Record
    said : sequence of str
        Reasons against its cores that are already known.
    calibrated : bool
        Whether the fit has used thermocouples in cores.
    before : KnownCore, optional
        Cores whose band is a lower limit for the new one, unless the new cores are proven, or every reason against them
        is measured.
    """
    fit, same = found.fit, None if calibrated else found
    core = known_core(fitted_model(fit, model, calibrated=calibrated, not_proven=said), records, same)
    kept = model.core_doubt if model.effects and not calibrated else 0.0  # a new fit of these effects keeps it
    share = 0.0 if core.proven else max(UNPROVEN, core.share_for(before) if before else kept)
    share = share if core.exchanged is None else core.exchanged
    if calibrated:  # the thermocouple may be nearer to the centre or to the mean than in the fit
        lever = probe_lever(model)
        share = max(share, lever.sd / (1.0 + lever.value))
    error = core.identified.model_error_K
    written = fitted_model(fit, model, calibrated=calibrated, doubt=share, model_error_K=error, not_proven=core.why)
    return written, core.widened(share)


def bands_of(found: Identified, share: float) -> tuple[CoreBand, ...]:
    """Compute the cores of each record from a fit, with its model error at the surface."""
    n = found.fit.problem.model.cells
    left = [max(s, found.model_error_K) for s in nearest(sensors(found.fit), n)]
    return core_bands(found.fit, left, share=share)


def _held_against(core: KnownCore, records: Sequence[Record]) -> KnownCore:
    """Hold cores against the thermocouples in them: one that contradicts its band is a reason, and is said once."""
    against = contradiction(core_checks(records, core.identified.fit, core.bands))
    if not against or any(why.startswith(CONTRADICTED) for why in core.why):
        return core
    return replace(core, why=(*core.why, against), exchanged=None).widened(UNPROVEN)


def _unusable(model: StringModel, records: Sequence[Record], doubts: Sequence[float]) -> list[str]:
    """Say why records can show no effect at all."""
    said = [f"{r.source}: {f.sentence}" for r in records for f in check_record(r, model) if f.severity == "stop"]
    if max(doubts) > HOPELESS:
        said.append("The rows of the current lie too far apart to know the heat between them.")
    return said


def _lacks(
    fitted: Identified, records: Sequence[Record], doubts: Sequence[float], searched: Search | None
) -> list[str]:
    """Say that the readings show a missing part of the model; empty if they do not."""
    own = f": it needs an error of its own of {fitted.model_error_K:.2g} K" if fitted.model_error_K else ""
    structured, fails_held = unexplained(fitted.closest, left_open(fitted.closest, doubts))
    if structured or fails_held:
        where = "the surfaces" if structured else "readings that were held out"
        return [f"The model does not explain {where}{own}."]
    found = searched or _search(fitted.closest, records, doubts)
    asked = _lacking(found.asked)
    rows_explain = found.left_open > 0.0 and not any(doubts)  # then they compete with what is in no catalogue too
    if not asked and rows_explain and more_than_rows(found.baseline, records):
        asked = LACKS_UNKNOWN
    return [asked] if asked else []


def _elsewhere(model: StringModel) -> list[str]:
    """Say which effects of a model could as well be something that leaves another core."""
    found = ((e.key, effect_named(e.name).elsewhere) for e in model.effects)
    return [
        f"At the surfaces {key} looks the same as {other}: the core then is another." for key, other in found if other
    ]


def _lacking(rounds: Sequence[Sequence[Trial]]) -> str:
    """Say which effect a model lacks although it explains the surfaces; empty if it lacks none."""
    trials = rounds[0] if rounds else []
    named = next((t.candidate for t in trials if t.passed), None)
    if named is not None:
        return f"These records ask for {named.effect.title} ({named.key}), which the model lacks."
    return LACKS_UNKNOWN if any(t.log_odds > ONE.ahead for t in trials) else ""


def _search(fit: MapFit, records: Sequence[Record], doubts: Sequence[float]) -> Search:
    """Return the search by which `diagnose` would judge; of one round, where further ones decide nothing."""
    model, ready = fit.problem.model, fit.problem.records
    found = search(model, ready, ONE, doubts=doubts, baseline=fit)
    if (found.chosen or found.orphan) and not any(doubts) and rows_may_matter(fit, records):
        # steps of the current between its rows compete with all effects of a search, not with its first one alone
        found = search(model, ready, doubts=doubts, baseline=fit)
        if rows_are_open(found, records):
            found = search(model, ready, ONE, doubts=[r.sampling.doubt for r in records], baseline=fit)
    return found


def numbers_far(fit: MapFit) -> list[str]:
    """Name the numbers of a fit that end at a bound, far from their prior, or outside the cell's format."""
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


def farthest(fit: MapFit) -> str:
    """Name the parameter of the cells that a fit moved farther from what was known of it than any other number.

    Empty if that is a number of an effect, or if it moved by less than `FAR`.
    """
    off = {
        c.name.partition("@")[0]: (abs(z - c.prior) / c.sd, c.effect is None)
        for c, z in zip(fit.problem.coordinates, fit.theta.tolist(), strict=True)
        if not c.only_start
    }
    name = max(off, key=lambda name: off[name], default="")
    return name if name and off[name][0] > FAR and off[name][1] else ""


def _vanished(c: Coordinate, z: float) -> bool:
    """Whether an effect's number ends where the effect vanishes, or at a full share: this is no fault."""
    if c.effect is None:
        return c.name.partition("@")[0] not in KINDS
    p = effect_named(c.effect.partition(":")[0]).parameter(c.name.rpartition(".")[2])
    return p.neutral is None or (float(np.exp(z)) if p.log else z) == p.neutral
