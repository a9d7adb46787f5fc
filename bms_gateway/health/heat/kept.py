"""Stored state of the watch over heat: knowledge of cells and sensors, strings at rest, heat that was found.

A string at rest continues after a restart as after a sleep, so its whole state is stored. Temperatures of a driven
string are useless a minute later, so only the other numbers are stored.
"""

from base64 import b64decode, b64encode
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bms_gateway.health.heat.fault_evidence import Kind
from bms_gateway.health.heat.filter import HeatFilter
from bms_gateway.health.heat.finding import Finding
from bms_gateway.health.heat.verdict import Verdict
from bms_gateway.thermal import Floats

LEAST_VAR = 1e-12
MOST_C = 1e3  # °C of a temperature
SLACK = 1e-3  # of a correlation, for rounding to 32 bit


def numbers(f: HeatFilter) -> dict[str, Any]:
    """Return the numbers other than the temperatures."""
    N = f.at.nodes
    told_at = [[x if np.isfinite(x) else None for x in row] for row in f.told_at.tolist()]
    return {
        "numbers": f.z[:, N:].tolist(),
        "variances": np.einsum("skk->sk", f.P)[:, N:].tolist(),
        "told_at": told_at,
    }


def take_numbers(f: HeatFilter, state: Mapping[str, Any]) -> None:
    """Restore the numbers.

    Raises
    ------
    KeyError, TypeError, ValueError
        `state` is not such a snapshot, or belongs to other strings.
    """
    at = f.at
    z, var = np.array(state["numbers"], np.float64), np.array(state["variances"], np.float64)
    shape = at.strings, at.states - at.nodes
    if z.shape == var.shape == (shape[0], shape[1] - 1):  # states of older versions have no stream
        w = at.stream - at.nodes
        z, var = np.insert(z, w, 0.0, axis=1), np.insert(var, w, np.square(f.usual.sd[:, at.stream]), axis=1)
    if z.shape != shape or var.shape != shape or not (np.isfinite(z).all() and np.isfinite(var).all()):
        raise ValueError("heat: not of these strings")
    told_at = np.array(state.get("told_at", f.told_at), np.float64)  # states of older versions have none; None is NaN
    if told_at.shape != f.told_at.shape or np.isinf(told_at).any() or (np.abs(told_at) > MOST_C).any():
        raise ValueError("heat: not of these strings")
    f.told_at = told_at
    f.z[:, at.nodes :] = z
    k = np.arange(at.nodes, at.states)
    f.P[:, at.nodes :, :] = 0.0
    f.P[:, k, k] = np.maximum(var, LEAST_VAR)


def at_rest(f: HeatFilter, s: int, age_s: float, inlet: float) -> dict[str, Any]:
    """Return the whole state of a string at rest: its covariance as a lower triangle in 32 bit."""
    triangle = f.P[s][np.tril_indices(f.at.states)].astype("<f4")
    return {
        "temperatures": f.z[s, : f.at.nodes].tolist(),
        "covariance": b64encode(triangle.tobytes()).decode("ascii"),
        "age_s": age_s,
        "inlet": inlet if np.isfinite(inlet) else None,
    }


def take_rest(f: HeatFilter, s: int, state: Mapping[str, Any]) -> tuple[float, float] | None:
    """Restore the state of a string at rest; return its running time, s, and its inlet, °C.

    None: the state is of an older version, without the stream; the string starts anew.

    Raises
    ------
    KeyError, TypeError, ValueError
        The stored values are not such a snapshot, or belong to another string.
    """
    at, N = f.at, f.at.states
    T = np.array(state["temperatures"], np.float64)
    triangle: Floats = np.frombuffer(b64decode(state["covariance"], validate=True), "<f4").astype(np.float64)
    if len(triangle) == (N - 1) * N // 2:
        return None
    age, inlet = float(state["age_s"]), float("nan") if state["inlet"] is None else float(state["inlet"])
    if T.shape != (at.nodes,) or len(triangle) != N * (N + 1) // 2 or not np.isfinite([*T, *triangle, age]).all():
        raise ValueError("heat: not of this string at rest")
    P = np.zeros((N, N))
    P[np.tril_indices(N)] = triangle
    P = P + np.tril(P, -1).T
    sd = np.sqrt(np.maximum(np.diag(P), LEAST_VAR))
    if (np.abs(P) > (1.0 + SLACK) * np.outer(sd, sd)).any() or np.abs(T).max() > MOST_C or np.isinf(inlet):
        raise ValueError("heat: no state of a string at rest")
    P[np.diag_indices(N)] = np.square(sd)
    f.z[s, : at.nodes], f.P[s], f.running[s] = T, P, True
    return max(0.0, age), inlet


def found(v: Verdict) -> list[dict[str, Any]]:
    """Return the heat that was found: a restart must not end an alarm."""
    return [
        {
            "place": g.place,
            "places": list(g.places),
            "since_ns": g.since_ns,
            "others": [list(o) for o in g.others],
            "sure": g.sure,
            "size": g.size,
        }
        for g in v.findings
        if g.kind is Kind.HEAT
    ]


def take_found(v: Verdict, stored: Sequence[Mapping[str, Any]], now_ns: int) -> None:
    """Restore heat that was found.

    Raises
    ------
    KeyError, TypeError, ValueError
        The stored values are not such a snapshot, or belong to another string.
    """
    at = v.of.at
    for x in stored:
        places = tuple(int(j) for j in x["places"])
        place, since = int(x["place"]), int(x["since_ns"])
        size, sure = float(x["size"]), float(x["sure"])
        others = tuple((str(name)[:40], float(share)) for name, share in x["others"][:3])
        sound = np.isfinite([size, sure, *(p for _, p in others)]).all() and place in places
        if not sound or not all(0 <= j < at.near and at.seen[v.s, j] for j in places):
            raise ValueError("heat: a finding of another string")
        cell = int(at.told[v.s, place]) + 1
        g = Finding("unexplained_heat", cell, 2, since, place=place, places=places, others=others, size=size, sure=sure)
        v.take_up(g, now_ns)
