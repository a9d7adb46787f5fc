"""Tables of the reports on one or two models: errors, cores, parameters, regimes as a heat map."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from bms_gateway.diagnosis.calibrate import AGAINST_FORMAT, AT_BOUND, MOVED, UNIDENTIFIABLE, statuses
from bms_gateway.diagnosis.core_band import BAND_SD, at_times, half_width_K, posterior
from bms_gateway.diagnosis.core_check import CoreCheck, outside
from bms_gateway.diagnosis.curve import Curve
from bms_gateway.diagnosis.error_words import half_width
from bms_gateway.diagnosis.misfit import Level, Sensor
from bms_gateway.diagnosis.regimes import Bin, Regime
from bms_gateway.errors import counted
from bms_gateway.identify.coordinates import Coordinate
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.report.core_text import UNKNOWN_K
from bms_gateway.report.diagnosis_text import WITH_SD, with_sd
from bms_gateway.report.html_series import Shown
from bms_gateway.report.page import amount, grouped, table
from bms_gateway.report.words import unit
from bms_gateway.thermal import KINDS, StringModel
from bms_gateway.thermal.centre import probe_lever
from bms_gateway.thermal.effects import EffectParameter, effect_named

DOUBTFUL = "doubtful"
"""First word of every status that a number has because it is not to be relied on."""
FEATURES_SHOWN = 6
SENSORS_SHOWN, TOGETHER = 16, 12
"""Most sensors in a heat map, and most columns for which before and after are in one map."""
TAP = "Tap a value: its number of readings, its sd and its RMSE stand here."
"""Text below a map until `told.js` shows a value."""
PLACES = 2, 4
"""Fewest and most decimals of a heat map: as many as the greatest value needs for two digits."""
BESIDE = 4
"""Most columns for which two heat maps are side by side."""


def errors_table(models: Sequence[Shown], *, noted: bool = True) -> str:
    """Errors per sensor, each model's columns side by side; `noted`: with an explanation of the columns below."""
    held = bool(models[0].levels[1].readings)
    columns = ("fitted, K", *(("held-out, K",) if held else ()), "structured, K", "z")
    groups = [("", ["surface", "noise, K"]), *((m.name, columns) for m in models)]
    rows = []
    for j, s in enumerate(models[0].sensors):
        row = [f"cell {s.cell}", amount(s.trained.floor_K)]
        for m in models:
            row += _levels(m.sensors[j].trained, m.sensors[j].held)[: 1 + held]
            row += [amount(m.sensors[j].structured_K), _z(m.sensors[j].z)]
        rows.append(row)
    if len(rows) > 1:
        row = ["all", amount(models[0].levels[0].floor_K)]
        for m in models:
            row += [*_levels(*m.levels)[: 1 + held], "", ""]
        rows.append(row)
    note = "Root mean squares of reading minus model. Noise: what sensor noise and rounding alone leave. "
    note += "Held-out: blocks that were never fitted to. " if held else ""
    note += "Structured: the part that is alike from reading to reading; above z = 6 it is not chance."
    return grouped(groups, rows, caption=note if noted else "")


def errors_apart(models: Sequence[Shown]) -> str:
    """Errors per sensor, one table after the other, if there is no room for columns side by side."""
    return "".join(errors_table([m], noted=m is models[-1]) for m in models)


def _z(z: float) -> str:
    return f"{round(z, 1) + 0.0:.1f}".replace("-", "−")


def _levels(trained: Level, held: Level) -> list[str]:
    def one(x: Level) -> str:
        text = amount(x.rmse_K)
        return f'<span class="alarm">{text}</span>' if x.rmse_K > 1.2 * x.floor_K else text

    return [one(trained), one(held)]


def cores_table(models: Sequence[Shown]) -> str:
    """Hottest core of each cell with its 95 % band; for a core that is not known only the band."""
    several = len(models[0].cores) > 1
    columns = ("hottest, °C", "± 95 % then, K", "± 95 %, rms, K")
    half = [half_width_K(m.cores) for m in models]
    groups = [("", ["core"]), *((m.name, columns) for m in models)]
    rows = []
    for r, band in enumerate(models[0].cores):
        for k in range(band.T_c.shape[1]):
            row = [f"cell {k + 1}" + (f", record {r + 1}" if several else "")]
            for m, of in zip(models, half, strict=True):
                b = m.cores[r]
                at = int(np.argmax(b.T_c[:, k]))
                hottest = f"{b.T_c[at, k]:.2f}" if of[k] <= UNKNOWN_K else '<span class="alarm">not known</span>'
                row += [hottest, half_width(BAND_SD * b.total_K[at, k]), half_width(of[k])]
            rows.append(row)
    return grouped(groups, rows)


def thermocouples_table(models: Sequence[Shown], checks: Sequence[CoreCheck]) -> str:
    """Models against thermocouples in cores that no fit has used."""
    if not checks:
        return ""
    groups = [("", ["core thermocouple"]), *((m.name, ("RMSE, K", "mean, K", "inside 95 %")) for m in models)]
    rows = []
    for c in checks:
        row = [f"cell {c.cell}" + (f", record {c.record + 1}" if len(models[0].cores) > 1 else "")]
        for m in models:
            read, sd = at_times(m.cores[c.record], c.cell, c.time_s, probe_lever(m.fit.problem.model))
            error = c.measured - read
            inside = float(np.mean(np.abs(error) <= BAND_SD * np.maximum(sd, 1e-9)))
            share = f"{100 * inside:.0f} %"
            share = f'<span class="danger">{share}</span>' if outside(inside) else share
            row += [amount(float(np.sqrt(np.mean(error**2)))), amount(float(np.mean(error))), share]
        rows.append(row)
    return grouped(
        groups, rows, caption="Mean: thermocouple minus model, where it is said to sit. It was never fitted to."
    )


def unlearnt(fit: MapFit) -> list[str]:
    """Labels of the numbers that the records do not determine."""
    return [called(c) for c, _, _, status in _free(fit) if status.startswith(UNIDENTIFIABLE)]


def free(fit: MapFit) -> int:
    """Count the numbers that the records could determine."""
    return len(_free(fit))


def at_limits(fit: MapFit) -> list[str]:
    """Labels of the numbers that ended at a limit: an alarm, not a result."""
    return [called(c) for c, _, _, status in _free(fit) if status == AT_BOUND]


def astray(fit: MapFit) -> list[str]:
    """Labels of the numbers that moved far from what was known of them and are no better known."""
    return [called(c) for c, _, _, status in _free(fit) if status == MOVED]


def called(c: Coordinate) -> str:
    """Return a number of a model by its label, with its symbol in brackets."""
    name, _, record = c.name.partition("@")
    label = KINDS[name].description if c.effect is None else _parameter(c).description
    return f"{label} ({name}{f', record {record}' if record else ''})"


def _parameter(c: Coordinate) -> EffectParameter:
    """Return the number of an effect for a coordinate of a fit, such as `cell_cooling:2.a`."""
    effect, _, name = c.name.rpartition(".")
    return effect_named(effect.partition(":")[0]).parameter(name)


@dataclass(frozen=True, slots=True)
class ShownAs:
    """Conversion of a coordinate of a fit to a number for people: a factor, whether it is a logarithm, and the unit."""

    scale: float
    log: bool
    unit: str

    def value(self, z: float) -> float:
        """Return the number."""
        return self.scale * (float(np.exp(z)) if self.log else z)


def shown_as(c: Coordinate, model: StringModel) -> ShownAs:
    """Return how a coordinate of a model's fit is shown."""
    if c.effect is None:
        name, _, _ = c.name.partition("@")
        kind, prior = KINDS[name], np.asarray(model.priors[name].value)
        return ShownAs(float(prior.mean()) / kind.to_si, True, unit(kind.unit))
    p = _parameter(c)
    return ShownAs(1.0 / p.to_si, p.log, unit(p.unit))


def parameters_table(fit: MapFit, *, doubted: bool = False, narrow: bool = False) -> str:
    """Numbers of a fit with sd, prior, limits, and status.

    Parameters
    ----------
    fit : MapFit
    doubted : bool
        As for `KnownCore.numbers_doubted`.
    narrow : bool
        Whether units are beside the labels.
    """
    rows = []
    for c, z, sd, status in _free(fit, doubted):
        s = shown_as(c, fit.problem.model)
        value, spread = s.value(z), (s.value(z) if s.log else s.scale) * sd
        before = f"{amount(s.value(c.prior))} ± " + (f"{100 * c.sd:.0f} %" if s.log else amount(s.scale * c.sd))
        limits = s.value(c.lower), s.value(c.upper)
        kept = not status.startswith((UNIDENTIFIABLE, AT_BOUND, AGAINST_FORMAT, DOUBTFUL))
        state = escape(status) if kept else f'<span class="alarm">{escape(status)}</span>'
        rows.append(
            [
                escape(f"{called(c)}, {s.unit}" if s.unit and narrow else called(c)),
                with_sd(float(value), float(spread)).replace("-", "−"),
                *([] if narrow else [s.unit]),
                before,
                f"{amount(limits[0])} … {amount(limits[1])}",
                state,
            ]
        )
    heads = [f"value {WITH_SD}", *([] if narrow else ["unit"]), f"known before, {WITH_SD}", "limits", "state"]
    return table(["number", *heads], rows, words=(0, 4) if narrow else (0, 2, 5))


def _free(fit: MapFit, doubted: bool = False) -> list[tuple[Coordinate, float, float, str]]:
    """Return each free number except the starts: coordinate, value, sd, and status."""
    sd = np.sqrt(np.diag(posterior(fit)))
    rows = zip(fit.problem.coordinates, fit.theta, sd, statuses(fit, doubted=doubted), strict=False)
    return [(c, float(z), float(s), status) for c, z, s, status in rows if not c.only_start]


def curve_table(c: Curve) -> str:
    """Return a coefficient over the SOC with its standard deviation."""
    rows = [
        [f"{100.0 * s:.0f} %", f"{v:+.3f}".replace("-", "−"), f"{sd:.3f}"]
        for s, v, sd in zip(c.soc, c.value, c.sd, strict=True)
    ]
    return table(["SOC", f"dU/dT, {c.unit}", f"{WITH_SD}, {c.unit}"], rows)


def heat_map(models: Sequence[Shown]) -> str:
    """Mean error by regime, feature by feature, one column per sensor and model."""
    first = models[0].sensors
    worst = sorted(range(len(first)), key=lambda j: -first[j].share)[:SENSORS_SHOWN]
    columns = sorted(worst)
    features = _features(models)
    means = [abs(b.mean_K) for f in features for m in models for j in columns for b in _bins(m.sensors[j], f)]
    largest = max(max(means, default=0.0), first[0].trained.floor_K)
    note = "Mean of reading minus model, K. Orange, +: the cell reads more than the model; blue, −: less. "
    note += "Bold: unlikely to be chance (over 3 sd). "
    note += "Neither: less than what would count against the model."
    if len(columns) < len(first):
        note += f" The {len(columns)} cells with the largest errors."
    # wider than a page, or more than before and after: one map per model
    if len(columns) * len(models) > TOGETHER or len(models) > 2:
        tables = [_heat_table([m], features, columns, largest, m.name) for m in models]
        return f'<p class="muted">{escape(note)}</p>' + "".join(tables)
    note += f" Before and after: {' and '.join(m.name for m in models)}." if len(models) > 1 else ""
    half = 1 + len(features) // 2 if len(columns) * len(models) <= BESIDE else len(features)
    parts = [part for part in (features[:half], features[half:]) if part]
    tables = [_heat_table(models, part, columns, largest) for part in parts]
    return f'<p class="muted">{escape(note)}</p><div class="beside">{"".join(tables)}</div>'


def _heat_table(
    models: Sequence[Shown], features: Sequence[str], columns: Sequence[int], largest: float, title: str = "while"
) -> str:
    cells = [models[0].sensors[j].cell for j in columns]
    grid = {f: [_bins(m.sensors[j], f) for j in columns for m in models] for f in features}
    # below what counts as a failure of the model there is nothing to point at, however sure it is
    least = [m.sensors[j].least_structure * m.sensors[j].trained.floor_K for j in columns for m in models]
    greatest = max((abs(b.mean_K) for row in grid.values() for bins in row for b in bins), default=0.0)
    places = int(np.clip(1.0 - np.floor(np.log10(max(greatest, 1e-9))), *PLACES))
    over = "".join(f'<th scope="colgroup" class="first" colspan="{len(models)}">cell {k}</th>' for k in cells)
    under = "".join(f'<th scope="col"{_first(i)}>{w}</th>' for _ in cells for i, w in enumerate(("before", "after")))
    under = f"<tr>{under}</tr>" if len(models) > 1 else ""
    wide = 1 + len(cells) * len(models)
    body = []
    for f in features:
        row = grid[f]
        regime = next(r for r in models[0].sensors[0].regimes if r.feature == f)
        if f != "always":
            what = escape(f"{regime.title}, {unit(regime.unit)}")
            body.append(f'<tr><th class="group" scope="rowgroup" colspan="{wide}">{what}</th></tr>')
        # the errors of each cell are sorted by its own surface
        shared = len({tuple(b.label for b in bins) for bins in row if bins}) == 1
        for i in range(max(len(bins) for bins in row)):
            same = [bins[i] for bins in row if i < len(bins)]
            tints = "".join(
                _heat(bins, i, (largest, least[n], places), _first(n % len(models))) for n, bins in enumerate(row)
            )
            label = same[0].label if shared else _between(same, regime)
            body.append(f'<tr><th scope="row">{escape(label).replace(" -", " −")}</th>{tints}</tr>')
    text = "\n".join(body).replace(" title=", ' tabindex="0" title=', 1)  # from there the arrow keys go on
    return (
        '<div class="map"><table class="heat"><thead><tr>'
        f'<th rowspan="{2 if under else 1}" scope="col">{escape(title)}</th>{over}</tr>{under}</thead>'
        f'<tbody>\n{text}\n</tbody></table><p class="cell-told" role="status">{TAP}</p></div>'
    )


def _first(i: int) -> str:
    return ' class="first"' if i == 0 else ""


def _features(models: Sequence[Shown]) -> list[str]:
    """Return `always`, and the features whose bins explain most of the first model's residual, over all sensors."""
    first = models[0].sensors
    weight: dict[str, float] = {}
    for s in first:
        for r in s.regimes:
            weight[r.feature] = weight.get(r.feature, 0.0) + s.share * r.share
    every = [{r.feature for r in s.regimes} for s in first]
    there = [f for f in weight if f != "always" and all(f in own for own in every)]
    return ["always", *sorted(there, key=lambda f: -weight[f])[:FEATURES_SHOWN]]


def _bins(s: Sensor, feature: str) -> tuple[Bin, ...]:
    return next((r.bins for r in s.regimes if r.feature == feature), ())


def _between(bins: Sequence[Bin], regime: Regime) -> str:
    low, high = float(np.mean([b.low for b in bins])), float(np.mean([b.high for b in bins]))
    # as many decimals as tell the ends apart: a record that starts at half a second starts at 0 min
    places = int(np.clip(1.0 - np.floor(np.log10(max(high - low, 1e-9))), 0.0, 4.0))
    first, last = (f"{round(x, places) + 0.0:g}" for x in (low, high))
    return f"about {first} to {last} {unit(regime.unit)}"


def _heat(bins: Sequence[Bin], i: int, scale: tuple[float, float, int], first: str) -> str:
    """Show one mean; `scale`: the value of the strongest colour, the least that has one, and decimals."""
    largest, least, places = scale
    if i >= len(bins):
        side = "first no" if first else "no"
        return f'<td class="{side}">–</td>'
    b = bins[i]
    share = float(np.clip(b.mean_K / largest, -1.0, 1.0)) if abs(b.mean_K) >= least else 0.0
    strong = abs(share) ** 0.7 * 0.75
    tint = (230, 140, 0) if share > 0 else (60, 140, 210)
    color = "".join(f"{round(255 + (c - 255) * strong):02x}" for c in tint)
    text = f"{b.mean_K:+.{places}f}".replace("-", "−") if abs(b.mean_K) >= 0.5 * 0.1**places else f"{0:.{places}f}"
    text = f"<b>{text}</b>" if b.significant and share else text
    told = f"{counted(b.readings, 'reading')}: {b.mean_K:+.3f} K, sd {b.sd_K:.3f} K, RMSE {b.rmse_K:.3f} K".replace(
        "-", "−"
    )
    return f'<td{first} style="background:#{color}" title="{told}">{text}</td>'
