"""Tables of a diagnosis: the ranking with its bars, what to measure next, what the data could show at all."""

from collections.abc import Sequence
from html import escape

import numpy as np

from bms_gateway.diagnosis.detect import Card, Detectable
from bms_gateway.diagnosis.experiment import ENOUGH_ODDS, Experiment
from bms_gateway.diagnosis.latent import Latent, watts
from bms_gateway.diagnosis.ranking import Standing
from bms_gateway.report.diagnosis_text import LINEAR, WITH_SD, meaning, number_lines, parts_of, reach
from bms_gateway.report.html_figures import WORTH
from bms_gateway.report.page import amount, paragraph, table
from bms_gateway.report.words import in_words, labelled, named, parameter_named, unit
from bms_gateway.thermal.effects import effect_named

TESTS_SHOWN = 6
FOLLOWS_SHOWN = 6
BAR = 150
"""Width of the evidence bars, px."""
SUPERSCRIPT = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
NAMED_AT = 3.0
"""Log-odds that an effect needs: 20 to 1."""
HATCH = (
    '<svg width="0" height="0" aria-hidden="true" style="position:absolute"><defs><pattern id="hatch" width="6" '
    'height="6" patternUnits="userSpaceOnUse" patternTransform="rotate(45)"><rect width="6" height="6" fill="#fff"/>'
    '<rect width="2.4" height="6" fill="#777"/></pattern></defs></svg>'
)


def ranking_table(ranked: Sequence[Standing], *, second: bool = False) -> str:
    """Return the ranking with evidence bars; named and tied effects are emphasised, refused ones are hatched.

    Bars with different models of comparison are in separate parts, each with its scale.
    """
    if not ranked:
        return ""
    told = any(r.role for r in ranked)
    weighed = any(np.isfinite(r.share) for r in ranked)
    rows = []
    for part in parts_of(ranked):
        rows.append(
            f'<tr class="group"><th class="group" scope="rowgroup">{part.title}</th><td>{_scale(part.top)}</td>'
            f'<td class="against" colspan="6">Bars: {escape(part.against)}.</td></tr>'
        )
        rows += [_row(r, part.top, told=told, weighed=weighed) for r in part.ranked]
    error = "error, K" if second else "held-out, K"
    heads = ["log-odds", *(["prob."] if weighed else []), error, *(["without it, K"] if told else [])]
    head = "".join(f'<th scope="col" class="n">{h}</th>' for h in heads)
    note = f"{meaning(ranked)}. An effect needs 3, which is 20 to 1: dashed line. "
    note += "Hatched: refused, with the reason."
    return (
        f'{HATCH}<table class="ranking"><caption>{escape(note[0].upper() + note[1:])}</caption><thead><tr>'
        f'<th scope="col">effect</th><th scope="col">evidence</th>{head}'
        f'<th scope="col">its numbers, {WITH_SD}</th><th scope="col">why not</th></tr></thead><tbody>\n'
        + "\n".join(rows)
        + "\n</tbody></table>"
    )


def _row(r: Standing, top: float, *, told: bool, weighed: bool) -> str:
    kind = {"named": "chosen", "tied": "tied"}.get(r.role, "")
    titles = " and ".join(effect_named(e.partition(":")[0]).title for e in r.effects) or r.name
    columns = [
        f"{r.evidence:.{1 if abs(r.evidence) < 1000.0 else 0}f}".replace("-", "−"),
        *([_share(r.share)] if weighed else []),
        amount(r.error_K),
        *([amount(r.without_K) if r.role == "named" else ""] if told else []),
    ]
    numbers = map(in_words, number_lines(r.effects, r.parameters))
    return (
        f'<tr class="{kind}"><th scope="row">{escape(titles)}<br><span class="muted">({escape(r.name)})</span></th>'
        f"<td>{_bar(r, top, kind)}</td>"
        + "".join(f'<td class="n">{c}</td>' for c in columns)
        + f'<td class="numbers">{"<br>".join(map(escape, numbers))}</td>'
        f'<td class="why">{escape(in_words(r.refused))}</td></tr>'
    )


def _share(share: float) -> str:
    if not np.isfinite(share):
        return ""
    return f"{100 * share:.0f} %" if share >= 0.005 else "&lt; 1 %"


def _bar(r: Standing, top: float, kind: str) -> str:
    width = max(BAR * reach(r.evidence, top), 1.5)
    fill = "url(#hatch)" if r.refused else "#0072b2" if kind == "chosen" else "#56b4e9" if kind == "tied" else "#999"
    edge = "#777" if r.refused else "#333"
    at = BAR * reach(NAMED_AT, top)
    told = f"log-odds {r.evidence:.1f}" + (", refused" if r.refused else "")
    return (
        f'<svg viewBox="0 0 {BAR + 2} 18" width="{BAR + 2}" role="img" aria-label="{told}">'
        f'<rect x="0.5" y="2.5" width="{width:.1f}" height="13" fill="{fill}" stroke="{edge}"/>'
        f'<line x1="{at:.1f}" x2="{at:.1f}" y1="0" y2="18" stroke="#000" stroke-dasharray="2 2"/></svg>'
    )


def _scale(top: float) -> str:
    if top > LINEAR:
        marks = [0.0, *(10.0 ** np.arange(1, int(np.log10(top)) + 1)).tolist()]
    else:
        step = 10.0 ** np.floor(np.log10(top))
        step = next(s for s in (step / 2, step, 2 * step, 5 * step) if top / s <= 4.0 + 1e-9)
        marks = np.arange(0.0, top + 1e-9, step).tolist()
    texts = "".join(
        f'<text x="{BAR * reach(t, top):.1f}" y="11" text-anchor="{_anchor(BAR * reach(t, top))}">{_power(t)}</text>'
        for t in marks
    )
    size = f'viewBox="0 0 {BAR + 2} 14" width="{BAR + 2}" font-size="10" font-weight="400"'
    return f'<svg {size} aria-hidden="true">{texts}</svg>'


def _power(t: float) -> str:
    return f"{t:g}" if t < 1e4 else f"10{str(round(np.log10(t))).translate(SUPERSCRIPT)}"


def _anchor(place: float) -> str:
    return "start" if place < 4.0 else "end" if place > BAR - 14.0 else "middle"


def follows_table(found: Latent) -> str:
    """Features that the missing heat may follow, with the share of the misfit that each explains."""
    if not any(f.share >= WORTH for f in found.follows):
        return ""
    same = found.alike
    rows = [
        [
            escape(f.title),
            f.node,
            "not told apart" if f in same and len(same) > 1 else f"{100 * f.share:.0f} %",
            f"{watts(f.slope, f.unit)}",
        ]
        for f in found.follows[:FOLLOWS_SHOWN]
        if f.share >= WORTH
    ]
    note = (
        "Share of the misfit above the noise that goes when a heat proportional to the feature is added there and all "
        "numbers are refitted; and that heat, more or less than modelled."
    )
    return table(["feature", "heat made at", "share", "heat"], rows, words=(0, 1, 2, 3), caption=note)


def experiment_table(e: Experiment) -> str:
    """List tests with their expected log-odds, pair by pair."""
    parts = []
    for p in e.partings:
        if p.sentence != e.sentence:
            parts.append(paragraph(p.sentence))
        rows = []
        for t in p.tests[:TESTS_SHOWN]:
            enough = "decides" if t.log_odds >= ENOUGH_ODDS else ""
            rows.append([escape(t.plan.instruction), f"{t.plan.minutes:.0f}", amount(t.log_odds), enough])
        note = f"To tell {labelled(p.one)} from {labelled(p.other)}: expected log-odds of each test; "
        note += f"{ENOUGH_ODDS:g} decide, 20 to 1."
        parts.append(table(["test", "min", "expected log-odds", ""], rows, words=(0, 3), caption=note))
    return "\n".join(parts)


def detectability_table(card: Card) -> str:
    """Smallest size of each effect that the data could show; effects with many places are in one row."""
    rows = []
    for name in dict.fromkeys(d.effect for d in card.effects):
        mine = [d for d in card.effects if d.effect == name]
        seen = [d for d in mine if d.visible]
        first = mine[0]
        low, high = min(d.smallest for d in mine), max(d.smallest for d in mine)
        size = amount(low, 2) if np.isfinite(low) else "none"
        if np.isfinite(low) and high > 1.05 * low:
            size += f" … {amount(high, 2) if np.isfinite(high) else 'none'}"
        usual, u = f"{amount(first.typical, 2)}", unit(first.unit)
        number = parameter_named([name], first.parameter)
        rows.append([escape(named(name)), escape(number), size, usual, u, _visible(mine, seen)])
    note = (
        "Smallest size that these data would show with log-odds of 3, and the size that the catalogue counts as usual; "
        "over the cells where an effect can sit on one, from the best to the worst place."
    )
    return table(["effect", "number", "smallest shown", "usual", "unit", ""], rows, words=(0, 1, 4, 5), caption=note)


def _visible(mine: Sequence[Detectable], seen: Sequence[Detectable]) -> str:
    if not seen:
        return '<span class="alarm">not at a usual size</span>'
    if len(seen) == len(mine):
        return "visible"
    return f"visible at cell {', '.join(str(d.cell) for d in seen)} only"
