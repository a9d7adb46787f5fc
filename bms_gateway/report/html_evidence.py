"""The common part of all reports, models against readings: the cards at the top, errors, overlays, regimes, cores."""

from collections.abc import Sequence
from html import escape

from bms_gateway.diagnosis.core_band import half_width_K
from bms_gateway.diagnosis.core_check import CoreCheck
from bms_gateway.diagnosis.core_known import unlike, unseen
from bms_gateway.diagnosis.error_words import half_width
from bms_gateway.diagnosis.latent import MISSING_Z, Latent
from bms_gateway.diagnosis.residuals import structure
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.report.core_text import UNKNOWN_K, rests_on
from bms_gateway.report.html_correlation import together
from bms_gateway.report.html_figures import WORTH, cores, drive, latent, overlay, residual_map
from bms_gateway.report.html_ranking import follows_table
from bms_gateway.report.html_series import Shown, clock, points_each, traces_of
from bms_gateway.report.html_tables import astray, at_limits, cores_table, free, heat_map, thermocouples_table, unlearnt
from bms_gateway.report.page import Card, amount, cards, figure, paragraph, section
from bms_gateway.report.show import kelvins

MANY = 6
"""Greatest number of overlays on a page for which they are drawn large."""


def _sample(shape: str) -> str:
    return f'<svg width="34" height="12" aria-hidden="true">{shape}</svg>'


SPACE = "\N{NO-BREAK SPACE}"
PAIRS = 2
"""Greatest number of pairs in the card of numbers that are hardly known apart; their table lists more."""
HELD_KEY = _sample('<rect width="34" height="12" fill="#ececec"/>') + "held out: never fitted to"
KEY = (
    _sample('<path d="M0 2H34M0 10H34" stroke="#777" stroke-dasharray="1 3"/>') + "± 2 sd of the sensor",
    _sample('<path d="M0 6H34" stroke="#777" stroke-width=".8"/>') + "reading minus model",
    _sample('<path d="M0 6H34" stroke="#777" stroke-width="3"/>') + "its mean over a minute",
)
"""Keys that the legends of the overlays lack."""


def summary(models: Sequence[Shown]) -> str:
    """Make four cards: errors against the noise, fitted and held out; the core; what is not identifiable.

    Parameters
    ----------
    models : sequence of Shown
        The cards show the numbers of the last one.
    """
    last_fit = models[-1].fit
    levels = [m.levels for m in models]
    fitted, held = levels[-1]
    line = f"noise alone {amount(fitted.floor_K)} K; {amount(fitted.ratio, 2)} × the noise"
    found = [Card("Error where fitted", _arrow([kelvins(x.rmse_K) for x, _ in levels]), line)]
    if held.readings:
        line = f"noise alone {amount(held.floor_K)} K; {amount(held.ratio, 2)} × the noise"
        found.append(Card("Error on held-out blocks", _arrow([kelvins(x.rmse_K) for _, x in levels]), line))
    half = [m.worst_core for m in models]
    line = f"cell {half[-1][1]}, known least"
    line += ", without a thermocouple" if half[-1][1] in unseen(last_fit) else ""
    line += f": ± {half_width(half[-1][0])} K" if half[-1][0] > UNKNOWN_K else ""
    told = [f"± {half_width(h)} K" if h <= UNKNOWN_K else "not known" for h, _ in half]
    found.append(Card("Core, 95 % band", _whole(" → ".join(told)), line))
    lost, stuck, odd, alike = unlearnt(last_fit), at_limits(last_fit), astray(last_fit), together(last_fit, short=True)
    lines = [f"at a limit, so not used: {', '.join(stuck)}"] if stuck else []
    lines += [f"far from what was known, yet no better known: {', '.join(odd)}"] if odd else []
    lines += [f"these are known no better than before: {', '.join(lost)}"] if lost else []
    apart = f", but hardly apart: {'; '.join(alike[:PAIRS])}" if alike else ""
    line = "; ".join(lines) or f"the data say something of every free parameter{apart}"
    found.append(Card("Not identifiable", f"{len(lost)} of {free(last_fit)} parameters" if lost else "nothing", line))
    return cards(found)


def _arrow(values: Sequence[str]) -> str:
    return _whole(" → ".join(values) + " K")


def _whole(text: str) -> str:
    """Keep a number with its sign and unit in one line, and an arrow with what it comes from."""
    return text.replace("± ", f"±{SPACE}").replace(" K", f"{SPACE}K").replace(" →", f"{SPACE}→")


def evidence(models: Sequence[Shown], checks: Sequence[CoreCheck] = ()) -> list[str]:
    """Return the sections that compare models with readings.

    Parameters
    ----------
    models : sequence of Shown
        One, or before and after; of the same records.
    checks : sequence of CoreCheck
        Thermocouples in cores that no fit has used.
    """
    said = (HELD_KEY, *KEY) if models[0].levels[1].readings else KEY
    key = '<ul class="key">' + "".join(f"<li>{t}</li>" for t in said) + "</ul>"
    return [
        section("overlay", "Measured and modelled", key, *_overlays(models), *_maps(models[-1])),
        section("regimes", "In which regime", heat_map(models)),
        section(
            "core",
            "Core temperature",
            cores_table(models),
            paragraph(rests_on(unseen(models[-1].fit), unlike(models[-1].fit))) if unseen(models[-1].fit) else "",
            thermocouples_table(models, checks),
            *_cores(models, checks),
        ),
    ]


def missing_heat(found: Latent, fit: MapFit) -> str:
    """Draw the missing heat of a fit and the features that it follows, with a table; say so if there is none."""
    if structure(fit).z <= MISSING_Z:
        return paragraph(found.sentence)
    parts = [paragraph(found.sentence)]
    for r, m in enumerate(fit.problem.records):
        time = clock(3600.0 * float(m.drive.hours[-1]))
        several = f", record {r + 1}" if len(fit.problem.records) > 1 else ""
        follows = ", and what it follows most" if any(f.share >= WORTH for f in found.follows) else ""
        caption = f"Missing heat, were it all made in the {found.node}{several}, ± 1 sd{follows}."
        told = f"Missing heat at the {found.node} over time, and the features that it follows"
        parts.append(figure(f"latent-{r + 1}", latent(found, r, m, time), caption, described=told, time=r))
    return "\n".join([*parts, follows_table(found)])


def _overlays(models: Sequence[Shown]) -> list[str]:
    fits = [m.fit for m in models]
    names = [m.name for m in models]
    traces = traces_of(fits)
    points = points_each(len(traces) * (1 + 2 * len(fits)))
    found = []
    height = 360 if len(traces) <= MANY else 290
    for r, m in enumerate(fits[0].problem.records):
        mine = [t for t in traces if t.record == r]
        time = clock(max(float(t.time_s.max()) for t in mine))
        if len(fits[0].problem.records) > 1:
            found.append(f"<h3>Record {r + 1}: {escape(m.source)}</h3>")
        for t in mine:
            caption = f"Cell {t.cell}."
            if len(t.time_s) > points:
                caption += f" Of {len(t.time_s)} readings the least and the greatest of each stretch are drawn."
            told = f"Surface temperature of cell {t.cell}, measured and modelled, over time; below it the residual"
            spec = overlay(t, names, m, time, points, height)
            found.append(figure(f"overlay-{r + 1}-{t.cell}", spec, caption, described=told, time=r))
        told = "Current, coolant inlet and what else is known of the drive, over time"
        spec = drive(m, time, points, models[0].fit.problem.model.flow)
        caption = "What drove the string. All figures of a record zoom together; a double click shows all again, and a "
        caption += "click in a legend hides a line."
        found.append(figure(f"drive-{r + 1}", spec, caption, described=told, time=r))
    return found


def _maps(last: Shown) -> list[str]:
    """Draw the residual of all sensors over time, of the last model, where there are several."""
    found = []
    for r, m in enumerate(last.fit.problem.records):
        mine = [t for t in traces_of([last.fit]) if t.record == r]
        if len(mine) < 2:
            continue
        time = clock(max(float(t.time_s.max()) for t in mine))
        caption = f"Reading minus model of all sensors, {last.name}. Orange: the cell reads more; blue: less."
        told = "Reading minus model of all sensors over time, as a map"
        found.append(figure(f"map-{r + 1}", residual_map(mine, m, time), caption, described=told, time=r))
    return found


def _cores(models: Sequence[Shown], checks: Sequence[CoreCheck]) -> list[str]:
    found = []
    for r, m in enumerate(models[0].fit.problem.records):
        check = next((c for c in checks if c.record == r), None)
        last = models[-1].cores[r]
        hottest = int(last.T_c.max(axis=0).argmax()) + 1
        cell = check.cell if check else hottest
        time = clock(float(last.time_s.max()))
        thermocouple = (check.time_s, check.measured) if check else None
        spec = cores(models, r, cell, m, time, thermocouple)
        caption = f"Core of cell {cell}{', the hottest,' if cell == hottest and last.T_c.shape[1] > 1 else ''} "
        caption += "with its 95 % band."
        caption += f" {rests_on([cell], unlike(models[-1].fit))}" if cell in unseen(models[-1].fit) else ""
        caption += "" if all(x.proven for x in models) else " Hatched: core not proven."
        vague = [x.name for x in models if half_width_K(x.cores)[cell - 1] > UNKNOWN_K]
        caption += f" Without a line, because the core is not known: {' and '.join(vague)}." if vague else ""
        told = f"Core temperature of cell {cell} over time with its 95 percent band"
        found.append(figure(f"core-{r + 1}", spec, caption, described=told, time=r))
    return found
