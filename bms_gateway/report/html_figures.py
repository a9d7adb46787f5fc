"""Figures of the reports as specifications of plotly.

Colours are of Okabe and Ito's set, which people with any common colour blindness can distinguish; line styles repeat
the distinction for print without colour.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from bms_gateway.diagnosis.core_band import BAND_SD, half_width_K
from bms_gateway.diagnosis.latent import Latent
from bms_gateway.diagnosis.regimes import instants_of
from bms_gateway.identify.coordinates import Measured
from bms_gateway.report.core_text import UNKNOWN_K
from bms_gateway.report.html_series import Clock, Shown, Trace, breaks_of, broken, envelope, held_out, smooth
from bms_gateway.report.page import Figure, numbers
from bms_gateway.report.step_names import FILED, REFITTED
from bms_gateway.report.words import unit
from bms_gateway.thermal import Floats

BLACK, BLUE, VERMILLION, GREEN, ORANGE, SKY, PURPLE = (
    "#000000",
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#e69f00",
    "#56b4e9",
    "#cc79a7",
)
MEASURED = "#4d4d4d"
ROAD = (VERMILLION, BLUE, GREEN, PURPLE, ORANGE, SKY)
"""Colours of the steps in their order, as on the page: from the file, refitted, one for each addition."""
HEATS = ((BLUE, "solid"), (ORANGE, "dash"), (GREEN, "dot"))
"""Colours of the cells whose missing heat is drawn."""
MAP_COLUMNS, MAP_ROW_PX, MAP_LEAST_PX, MAP_MOST_PX = 150, 16, 90, 640
"""Columns of a map of the residual, height of its rows, and limits of its height."""
MAP_COLORS = [[0.0, "#3c8cd2"], [0.5, "#ffffff"], [1.0, "#e68c00"]]
"""As in the tables by regime: blue for less than the model, orange for more."""
HEAT_PX, FEATURE_PX, GAP_PX = 165, 95, 18
EDGES_PX = 76
"""Above and below the panels of a figure."""
SURFACE = "surface, °C"
PER_MIN = 60_000.0
"""l/min in a m³/s."""
FLOW_MOVES = 0.01
"""Share of the nominal flow: with smaller changes, the flow counts as constant and is not drawn."""
FEATURES, WORTH = 2, 0.02
"""Features drawn below it, and the least share of the misfit of a shown feature."""
COARSE_K = 0.02
"""Noise of one reading above which hundredths of a kelvin are drawn and no thousandths."""
STEPS = "hvh"
"""Line of a value that is constant around its sample, and not interpolated to the next."""
HATCH = {"shape": "/", "size": 8, "solidity": 0.25}
"""Fill of a band whose core is not proven."""
HELD = "rgba(0,0,0,0.075)"
GRID = "#e3e3e3"


def layout(height: int, m: Measured, clock: Clock, **more: Any) -> dict[str, Any]:
    """Return the common layout of all figures over the time of a record."""
    t = instants_of(m)
    x = axis(f"time, {clock.unit}", range=clock.around(float(t[0]), float(t[-1])))
    return {
        "height": height,
        "margin": {"l": 64, "r": 14, "t": 34, "b": 42},
        "font": {"family": "system-ui, Segoe UI, Liberation Sans, Arial, sans-serif", "size": 12, "color": "#1a1a1a"},
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "hovermode": "x",
        "dragmode": "zoom",
        "legend": {"orientation": "h", "x": 0, "y": 1.01, "xanchor": "left", "yanchor": "bottom"},
        "xaxis": x,
        **more,
    }


def axis(title: str, **more: Any) -> dict[str, Any]:
    """Return one axis with a title and a grid."""
    return {
        "title": {"text": title, "standoff": 6},
        "gridcolor": GRID,
        "zeroline": False,
        "linecolor": "#777777",
        "showline": True,
        "ticks": "outside",
        "automargin": False,
        **more,
    }


def line(x: Sequence[float], y: Sequence[float | None], name: str, color: str, **more: Any) -> dict[str, Any]:
    """Return one line."""
    style = {"color": color, "width": more.pop("width", 1.6), "dash": more.pop("dash", "solid")}
    return {"type": "scatter", "mode": "lines", "x": x, "y": y, "name": name, "line": style, **more}


def shaded(m: Measured, clock: Clock) -> list[dict[str, Any]]:
    """Draw held-out stretches as a grey background."""
    return [
        {
            "type": "rect",
            "xref": "x",
            "yref": "paper",
            "x0": clock(np.array([a]))[0],
            "x1": clock(np.array([b]))[0],
            "y0": 0,
            "y1": 1,
            "fillcolor": HELD,
            "line": {"width": 0},
            "layer": "below",
        }
        for a, b in held_out(m)
    ]


def _level(y: float, axis_name: str) -> dict[str, Any]:
    style = {"color": "#777777", "width": 1, "dash": "dot"}
    place = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "yref": axis_name, "y0": y, "y1": y}
    return {**place, "line": style, "layer": "below"}


def overlay(trace: Trace, names: Sequence[str], m: Measured, clock: Clock, points: int, height: int) -> Figure:
    """Draw readings and models of one sensor, and the residuals below.

    Parameters
    ----------
    trace : Trace
    names : sequence of str
        Of the models.
    m : Measured
        The trace's record.
    clock : Clock
    points : int
        Most points per trace.
    height : int, px
    """
    digits = 2 if trace.sigma_K > COARSE_K else 3

    def thin(y: Floats) -> tuple[list[float], list[float | None]]:
        t, few = broken(*envelope(trace.time_s, y, points), trace.breaks_s)
        return clock(t), numbers(few, digits)

    data = [line(*thin(trace.measured), "measured", MEASURED, width=1)]
    for name, model, (color, dash) in zip(names, trace.models, styles(names), strict=True):
        data.append(line(*thin(model), name, color, dash=dash, width=2, legendgroup=name))
    small: dict[str, Any] = {"yaxis": "y2", "showlegend": False}
    for name, model, (color, _) in zip(names, trace.models, styles(names), strict=True):
        each = line(*thin(trace.measured - model), name, color, width=0.7, opacity=0.4, legendgroup=name, **small)
        data.append({**each, "hoverinfo": "skip"})
    for name, model, (color, dash) in zip(names, trace.models, styles(names), strict=True):
        t, mean = broken(*smooth(trace.time_s, trace.measured - model, trace.breaks_s), trace.breaks_s)
        data.append(line(clock(t), numbers(mean), name, color, dash=dash, width=2.4, legendgroup=name, **small))
    band = [_level(s * 2.0 * trace.sigma_K, "y2") for s in (-1.0, 1.0)]
    spec = layout(
        height,
        m,
        clock,
        yaxis=axis(SURFACE, domain=[0.47, 1.0]),
        yaxis2=axis("residual, K", domain=[0.0, 0.41], zeroline=True, zerolinecolor="#777777"),
        shapes=[*shaded(m, clock), *band],
    )
    spec["xaxis"]["anchor"] = "y2"
    return {"data": data, "layout": spec}


def residual_map(traces: Sequence[Trace], m: Measured, clock: Clock) -> Figure:
    """Draw the residual of several sensors over time as a map: means over equal stretches, K.

    Parameters
    ----------
    traces : sequence of Trace
        Of one record, each with one model.
    m : Measured
        The record.
    clock : Clock
    """
    ends = instants_of(m)
    edges = np.linspace(float(ends[0]), float(ends[-1]), MAP_COLUMNS + 1)
    rows: list[list[float | None]] = []
    for t in traces:
        left = t.measured - t.models[0]
        at = np.clip(np.searchsorted(edges, t.time_s, "right") - 1, 0, MAP_COLUMNS - 1)
        n = np.bincount(at, minlength=MAP_COLUMNS)
        mean = np.bincount(at, left, MAP_COLUMNS) / np.where(n > 0, n, np.nan)
        rows.append(numbers(mean, 2 if t.sigma_K > COARSE_K else 3))
    most = max((abs(x) for row in rows for x in row if x is not None), default=0.0) or 1.0
    one: dict[str, Any] = {
        "type": "heatmap",
        "x": clock(0.5 * (edges[1:] + edges[:-1])),
        "y": [str(t.cell) for t in traces],
        "z": rows,
    }
    bar: dict[str, Any] = {"thickness": 10, "title": {"text": "K"}}
    one |= {"zmin": -most, "zmax": most, "colorscale": MAP_COLORS, "colorbar": bar, "hoverongaps": False}
    height = int(np.clip(MAP_ROW_PX * len(traces), MAP_LEAST_PX, MAP_MOST_PX)) + EDGES_PX
    cells = axis("cell", type="category", autorange="reversed", showgrid=False)
    return {"data": [one], "layout": layout(height, m, clock, yaxis=cells)}


NOT_MEASURED = "not measured"
BESIDE = {"xref": "paper", "x": 0.01, "xanchor": "left", "y": 1.0, "yanchor": "bottom", "showarrow": False}
"""Place of a remark in a picture with several axes: in the gap above its own, where no curve is."""


def drive(m: Measured, clock: Clock, points: int, nominal_m3_s: float | None) -> Figure:
    """Draw the inputs of the string: current, inlet, and, if known, charge and flow (over the nominal flow).

    What nobody measured is dashed, and says what stands for it.
    """
    u = m.drive
    rows = [("current", "current, A", u.I, BLACK), ("coolant_inlet", "inlet, °C", u.T_in, BLUE)]
    if "soc" in u.known:
        rows.append(("soc", "SOC, %", 100.0 * u.soc, GREEN))
    if "flow" in u.known and nominal_m3_s is not None and float(np.ptp(u.flow)) > FLOW_MOVES:
        rows.append(("coolant_flow", "flow, l/min", nominal_m3_s * PER_MIN * u.flow, PURPLE))
    data, axes, said = [], {}, list[dict[str, Any]]()
    height = 1.0 / len(rows)
    for i, (quantity, title, y, color) in enumerate(rows):
        suffix = "" if i == 0 else str(i + 1)
        t, few = broken(*envelope(3600.0 * u.hours, y, points), breaks_of(m))
        assumed = m.assumed.get(quantity, "")
        dash = "dash" if assumed else "solid"
        one = line(clock(t), numbers(few), title, color, width=1.2, yaxis=f"y{suffix}", showlegend=False, dash=dash)
        if assumed:
            one["meta"] = f"{NOT_MEASURED}: {assumed}"
            said.append(
                {**BESIDE, "text": one["meta"], "yref": f"y{suffix} domain", "font": {"color": color, "size": 12}}
            )
        if quantity != "coolant_inlet":
            one["line"]["shape"] = STEPS
        data.append(one)
        top = 1.0 - i * height
        axes[f"yaxis{suffix}"] = axis(title, domain=[max(top - height + 0.05, 0.0), top], nticks=4)
    spec = layout(72 + 92 * len(rows), m, clock, shapes=shaded(m, clock), annotations=said, **axes)
    spec["xaxis"]["anchor"] = "y" if len(rows) == 1 else f"y{len(rows)}"
    return {"data": data, "layout": spec}


def cores(
    models: Sequence[Shown],
    record: int,
    cell: int,
    m: Measured,
    clock: Clock,
    thermocouple: tuple[Floats, Floats] | None = None,
) -> Figure:
    """Draw the core of one cell with its 95 % band, before and after, and its thermocouple if there is one.

    Parameters
    ----------
    models : sequence of Shown
        Bands of cores that are not proven are hatched; for a core that is not known only the band is drawn.
    record, cell : int
        Record from 0, cell from 1.
    m : Measured
        The record.
    clock : Clock
    thermocouple : tuple of ndarray, ndarray (K,), optional
        Times, s, and readings, °C.
    """
    data: list[dict[str, Any]] = []
    k, looks = cell - 1, styles([x.name for x in models])
    for x, (color, _) in zip(models, looks, strict=True):
        band, name = x.cores[record], x.name
        half = BAND_SD * band.total_K[:, k]
        t = clock(band.time_s)
        low, high = numbers(band.T_c[:, k] - half), numbers(band.T_c[:, k] + half)
        edge = {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip", "showlegend": False, "legendgroup": name}
        data.append({"type": "scatter", "x": t, "y": low, "name": name, **edge})
        hatch = {**HATCH, "fgcolor": faint(color, 0.55), "bgcolor": faint(color)}
        fill = {"fill": "tonexty", **({"fillcolor": faint(color)} if x.proven else {"fillpattern": hatch})}
        data.append({"type": "scatter", "x": t, "y": high, "name": name, **fill, **edge})
    for x, (color, dash) in zip(models, looks, strict=True):
        if half_width_K(x.cores)[k] > UNKNOWN_K:
            continue
        band = x.cores[record]
        core = numbers(band.T_c[:, k])
        data.append(line(clock(band.time_s), core, x.name, color, dash=dash, width=2, legendgroup=x.name))
    if thermocouple is not None:
        t_s, y = envelope(*thermocouple, 2000)
        data.append(line(clock(t_s), numbers(y), "thermocouple in the core", BLACK, width=1.3, dash="dot"))
    spec = layout(290, m, clock, yaxis=axis(f"cell {cell}: core, °C"), shapes=shaded(m, clock))
    return {"data": data, "layout": spec}


def latent(found: Latent, record: int, m: Measured, clock: Clock) -> Figure:
    """Draw the missing heat of the cells with most of it, and below the features that explain most of it."""
    of_node = [h for h in found.heats if h.node == found.node]
    mine = sorted((h for h in of_node if h.record == record), key=lambda h: -h.rms_W)[: len(HEATS)]
    worst = [h is mine[0] for h in of_node].index(True)
    data: list[dict[str, Any]] = []
    for h, (color, dash) in zip(mine, HEATS, strict=False):
        t, name = clock(h.time_s), f"cell {h.cell}"
        edge = {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip", "showlegend": False, "legendgroup": name}
        low, high = numbers(h.heat_W - h.sd_W, 4), numbers(h.heat_W + h.sd_W, 4)
        data.append({"type": "scatter", "x": t, "y": low, "name": name, **edge})
        fill = {"fill": "tonexty", "fillcolor": faint(color)}
        data.append({"type": "scatter", "x": t, "y": high, "name": name, **fill, **edge})
        data.append(line(t, numbers(h.heat_W, 4), name, color, dash=dash, width=2, legendgroup=name))
    moving = [f for f in found.follows if f.feature != "constant" and f.share >= WORTH]
    follows = [f for f in moving if f.node == found.node][:FEATURES]
    inside = HEAT_PX + FEATURE_PX * len(follows)
    axes: dict[str, Any] = {}
    notes: list[dict[str, Any]] = []
    for i, f in enumerate(follows):
        x = line(clock(mine[0].time_s), numbers(f.values[worst], 4), f.title, BLACK, width=1.2, showlegend=False)
        data.append({**x, "yaxis": f"y{i + 2}"})
        bottom = FEATURE_PX * (len(follows) - 1 - i)
        domain = [bottom / inside, (bottom + FEATURE_PX - GAP_PX) / inside]
        axes[f"yaxis{i + 2}"] = axis(unit(f.unit), domain=domain, nticks=4)
        notes.append(
            {
                "text": f.title,
                "xref": "paper",
                "x": 0.005,
                "xanchor": "left",
                "yref": f"y{i + 2} domain",
                "y": 1.0,
                "yanchor": "top",
                "showarrow": False,
                "bgcolor": "rgba(255,255,255,0.75)",
            }
        )
    heat = axis("missing heat, W", domain=[1.0 - HEAT_PX / inside, 1.0], zeroline=True, zerolinecolor="#777777")
    spec = layout(inside + EDGES_PX, m, clock, yaxis=heat, shapes=shaded(m, clock), annotations=notes, **axes)
    spec["xaxis"]["anchor"] = f"y{len(follows) + 1}" if follows else "y"
    return {"data": data, "layout": spec}


def styles(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return colour and line style of each step: the newest one's line is solid, earlier ones are dashed.

    Examples
    --------
    >>> styles([FILED, REFITTED])
    [('#d55e00', 'dash'), ('#0072b2', 'solid')]
    >>> styles([REFITTED, "+ coolant arrives late (coolant_delay)"])
    [('#0072b2', 'dash'), ('#009e73', 'solid')]
    """
    place, found = {FILED: 0, REFITTED: 1}, []
    added = (k for k in range(2, len(ROAD)))
    for name in names:
        if name not in place:
            place[name] = next(added)
        found.append((ROAD[place[name]], "solid" if name == names[-1] else "dash"))
    return found


def faint(color: str, share: float = 0.16) -> str:
    """Return the colour as a transparent fill.

    Examples
    --------
    >>> faint("#0072b2")
    'rgba(0,114,178,0.16)'
    """
    r, g, b = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({r},{g},{b},{share:g})"
