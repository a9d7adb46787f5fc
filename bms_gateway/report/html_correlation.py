"""Correlation of the numbers of a fit as a table: how well they are known separately."""

from html import escape

import numpy as np

from bms_gateway.diagnosis.core_band import posterior
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.report.html_tables import called
from bms_gateway.report.page import paragraph
from bms_gateway.thermal import Floats

APART = 0.9
"""Correlation above which only one combination of two numbers is known."""
MOST, TOLD = 40, 6
"""Most numbers in a table, and most reported pairs that are hardly known separately."""


def correlations(fit: MapFit) -> tuple[list[str], Floats]:
    """Return a fit's numbers except the starts, each by its label, and their correlation (P, P)."""
    at = shown(fit)
    covariance = posterior(fit)[np.ix_(at, at)]
    sd = np.sqrt(np.diag(covariance))
    return [called(fit.problem.coordinates[i]) for i in at], np.clip(covariance / np.outer(sd, sd), -1.0, 1.0)


def shown(fit: MapFit) -> list[int]:
    """Return the places of the numbers of a fit except the starts."""
    return [i for i, c in enumerate(fit.problem.coordinates) if not c.only_start][:MOST]


def together(fit: MapFit, *, short: bool = False) -> list[str]:
    """List the pairs of numbers that are hardly known apart, with their correlation, the strongest first.

    `short`: by their symbols alone.
    """
    names, r = correlations(fit)
    if short:
        names = [fit.problem.coordinates[i].name.replace("@", " of record ") for i in shown(fit)]
    pairs = [(float(r[i, j]), i, j) for i in range(len(names)) for j in range(i) if abs(r[i, j]) > APART]
    pairs.sort(key=lambda p: -abs(p[0]))
    return [f"{names[i]} and {names[j]}: {_number(x)}" for x, i, j in pairs]


def correlation_table(fit: MapFit) -> str:
    """Return the correlation of a fit's numbers as a table, with a sentence on numbers that are not known separately.

    Labels are long: the head of a column has only the position of its number in the rows.
    """
    names, r = correlations(fit)
    n = len(names)
    if n < 2:
        return ""
    told = together(fit)
    said = (
        f"Hardly known apart: {'; '.join(told[:TOLD])}."
        if told
        else f"No two numbers are correlated by more than {APART:g}."
    )
    head = "".join(f'<th scope="col" aria-label="{escape(name)}">{j}</th>' for j, name in enumerate(names[:-1], 1))
    rows = []
    for i in range(n):
        cells = "".join(_cell(float(r[i, j])) for j in range(i)) + "<td></td>" * (n - 1 - i)
        rows.append(f'<tr><th scope="row">{i + 1} {escape(names[i])}</th>{cells}</tr>')
    table = (
        f'<table class="heat"><thead><tr><th scope="col"></th>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table>'
    )
    return paragraph(said) + table


def _cell(x: float) -> str:
    color = "213,94,0" if x > 0.0 else "0,114,178"
    text = f"<b>{_number(x)}</b>" if abs(x) > APART else _number(x)
    # on white in either theme, as the other maps of the page: the figure stays legible
    return f'<td style="background:linear-gradient(rgba({color},{0.55 * abs(x):.2f}) 0 0) #fff">{text}</td>'


def _number(x: float) -> str:
    text = f"{x:.2f}"
    return "0" if float(text) == 0.0 else text.replace("-", "−")
