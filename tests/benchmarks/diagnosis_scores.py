"""Scores of many diagnoses, each with its count and its goal; who was taken for whom; every miss on one line."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.truth.sizes import AFTER_A_CELL, LOCATED

VISIBLE = 3.0
"""Log-odds of the true effect, fitted directly, from which a diagnosis is held responsible for finding it."""
SEEN = 6.0
"""Log-likelihood that tells what is in no catalogue from nothing, shape and size known, from which it shows at all."""
HELD, NEW = 1.15, 1.2
"""Times the noise floor that a right verdict may leave on held-out readings, on a new drive."""


def visible(o):
    """Whether every hidden effect of the catalogue shows, each fitted given the others."""
    return bool(o["hidden"]) and all((h["odds"] or -np.inf) >= VISIBLE for h in o["hidden"])


def shows(o):
    """Whether what is in no catalogue could be seen by anybody; so it counts where that was not computed."""
    return o.get("seen") is None or o["seen"] >= SEEN


def hidden(o):
    return [h["effect"] for h in o["hidden"]]


def names(v):
    return [n["effect"] for n in v["named"]]


def wrong(o, v):
    """Effects named that are not there, nor declared as indistinguishable from one that is."""
    there = set(hidden(o))
    return [n["effect"] for n in v["named"] if n["effect"] not in there and not there & set(n["tied"])]


def in_group(o, v):
    first = v["named"][0] if v["named"] else {"effect": None, "tied": []}
    return hidden(o)[0] in (first["effect"], *first["tied"])


def right(o, v):
    """All that is hidden is named, and nothing else."""
    return bool(o["hidden"]) and sorted(names(v)) == sorted(hidden(o))


def told_unknown(o, v):
    return v["verdict"] == "unknown_effect" or v["remains"]


def quiet(o, v):
    return v["verdict"] == "adequate" and not v["remains"]


def reported(o, v):
    """Whether nothing is claimed, and told that a parameter takes up what is there; the peer tells no such thing."""
    return quiet(o, v) and all(v["absorbs"].values()) if "absorbs" in v else None


def cell_right(o, v):
    """None where the cell of the hidden effect is not to be told: it has none, or no sensor."""
    h = o["hidden"][0]
    if h["effect"] not in LOCATED or h["effect"] not in names(v):
        return None
    around = (h["cell"], h["cell"] + 1) if h["effect"] in AFTER_A_CELL else (h["cell"],)
    if not set(around) <= set(o["sensors"]):
        return None
    return h["cell"] in [n["cell"] for n in v["named"] if n["effect"] == h["effect"]]


@dataclass(frozen=True)
class Score:
    """One line: over which logs, what is counted, and the goal. `count` gives True, False, or None to leave it out."""

    text: str
    goal: float | None
    of: Callable
    count: Callable
    at_most: bool = False


def _single(o):
    return o["suite"] in ("singles", "one_cell") and visible(o)


def _sized(*sizes):
    return lambda o: o["suite"] == "singles" and visible(o) and o["hidden"][0]["size"] in sizes


def _suite(name):
    return lambda o: o["suite"] == name


def _strange(o):
    return o["suite"] == "unknowns" and shows(o)


def _pair(o):
    return o["suite"] == "pairs" and visible(o)


def _shown(o):
    return o["suite"] in ("singles", "one_cell", "pairs") and visible(o)


def _first(o, v):
    return names(v)[:1] == hidden(o)


def _ratio(o, v, key, most):
    if not right(o, v) or v.get(key) is None:
        return None
    rmse = v[key][1] if isinstance(v[key], list) else v[key]
    return rmse <= most * o["floor"]


LONG = 12
"""Cells of the strings whose time has a goal."""

SCORES = (
    Score("one effect, 5-12 cells, medium and strong: named first", 0.95, _sized("medium", "strong"), _first),
    Score("one effect, 5 cells, weak: named first", None, _sized("weak"), _first),
    Score("one effect, one cell: named first", 0.90, lambda o: o["suite"] == "one_cell" and visible(o), _first),
    Score("one effect: named first or in the declared group", 0.98, _single, in_group),
    Score("one effect: a wrong name outside the group", 0.01, _single, lambda o, v: bool(wrong(o, v)), at_most=True),
    Score("one effect: said to be unknown", None, _single, lambda o, v: v["verdict"] == "unknown_effect"),
    Score("cell right where it has a sensor", 0.95, _single, cell_right),
    Score("nothing hidden: false alarms", 0.0, _suite("controls"), lambda o, v: not quiet(o, v), at_most=True),
    Score("absorbed by a parameter: adequate", 1.0, _suite("absorbed"), quiet),
    Score("absorbed by a parameter: adequate and reported as absorbed", 1.0, _suite("absorbed"), reported),
    Score("in no catalogue: unknown, or something unknown remains", 0.90, _strange, told_unknown),
    Score("in no catalogue: a cause named", 0.03, _suite("unknowns"), lambda o, v: bool(v["named"]), at_most=True),
    Score(
        "in no catalogue: a cause named as all there is",
        None,
        _suite("unknowns"),
        lambda o, v: bool(v["named"]) and not v["remains"],
    ),
    Score("two effects: both named", 0.85, _pair, lambda o, v: set(hidden(o)) <= set(names(v))),
    Score(
        "two effects: at least one named, nothing wrong",
        0.97,
        _pair,
        lambda o, v: bool(set(hidden(o)) & set(names(v))) and not wrong(o, v),
    ),
    Score(f"right verdicts: held-out RMSE <= {HELD} x noise", 0.95, _shown, lambda o, v: _ratio(o, v, "held", HELD)),
    Score(
        f"right verdicts: new drive RMSE <= {NEW} x noise", 0.95, _shown, lambda o, v: _ratio(o, v, "new_drive", NEW)
    ),
    Score(
        "right verdicts: true core error falls",
        0.97,
        _shown,
        lambda o, v: v["core"][1] < v["core"][0] if right(o, v) else None,
    ),
    Score(
        "right verdicts, core called better known: its error falls",
        0.97,
        _shown,
        lambda o, v: v["core"][1] < v["core"][0] if right(o, v) and v.get("core_claimed") else None,
    ),
    Score(
        "right verdicts: the core called better known",
        None,
        _shown,
        lambda o, v: v["core_claimed"] if right(o, v) and "core_claimed" in v else None,
    ),
)


def table(outcomes):
    """Lines of text: every score of ours and, where it ran, of the peer."""
    peer = any(o["peer"] for o in outcomes)
    lines = [f"{'':60}{'goal':>8}{'ours':>20}" + (f"{'prototype':>20}" if peer else "")]
    for s in SCORES:
        if not any(s.of(o) for o in outcomes):
            continue
        goal = "" if s.goal is None else f"{'<=' if s.at_most else '>='}{100 * s.goal:.0f} %"
        cells = [_share(s, outcomes, who) for who in (("ours", "peer") if peer else ("ours",))]
        lines.append(f"{s.text:60}{goal:>8}" + "".join(f"{c:>20}" for c in cells))
    for text, goal, of in (
        ("right verdicts: core error after / before, median", "<=0.33", _core_ratio),
        ("parameters inside their own 95 % interval", ">=90 %", _inside),
        ("core error after, median K", "", _core_after),
        ("one diagnosis, median / 95 % s of CPU", "", _seconds),
        ("12 cells, nothing or one effect: the same", "<=3", lambda some, who: _seconds(filter(_long, some), who)),
        ("two effects: the same", "<=10", lambda some, who: _seconds(filter(_pair, some), who)),
        ("CPU of it, ours / prototype on the same log, median", "", _against_peer),
    ):
        cells = [of(outcomes, who) for who in (("ours", "peer") if peer else ("ours",))]
        lines.append(f"{text:60}{goal:>8}" + "".join(f"{c:>20}" for c in cells))
    shown = [o for o in outcomes if o["suite"] in ("singles", "one_cell", "pairs")]
    if shown:
        lines.append(f"visible: {sum(map(visible, shown))} of {len(shown)} logs with effects of the catalogue")
    if strange := [o for o in outcomes if o["suite"] == "unknowns"]:
        lines.append(f"visible: {sum(map(shows, strange))} of {len(strange)} logs with what is in no catalogue")
    return lines


def _share(score, outcomes, who):
    counts = [score.count(o, o[who]) for o in outcomes if o[who] and score.of(o)]
    counts = [c for c in counts if c is not None]
    if not counts:
        return "-"
    share = np.mean(counts)
    met = "" if score.goal is None or (share <= score.goal if score.at_most else share >= score.goal) else "!"
    return f"{met}{100 * share:.1f} % ({sum(counts)}/{len(counts)})"


def _right(outcomes, who):
    return [o for o in outcomes if o[who] and _shown(o) and right(o, o[who])]


def _core_ratio(outcomes, who):
    ratios = [o[who]["core"][1] / o[who]["core"][0] for o in _right(outcomes, who)]
    return f"{np.median(ratios):.2f} ({len(ratios)})" if ratios else "-"


def _core_after(outcomes, who):
    after = [o[who]["core"] for o in _right(outcomes, who)]
    return "{:.2f} -> {:.2f}".format(*np.median(after, axis=0)) if after else "-"


def _inside(outcomes, who):
    inside = [b for o in _right(outcomes, who) for e in o[who].get("inside", {}).values() for b in e.values()]
    return f"{100 * np.mean(inside):.1f} % ({sum(inside)}/{len(inside)})" if inside else "-"


def _seconds(outcomes, who):
    seconds = [o[who]["seconds"] for o in outcomes if o[who]]
    return f"{np.median(seconds):.1f} / {np.quantile(seconds, 0.95):.1f}" if seconds else "-"


def _long(o):
    return o["cells"] == LONG and o["suite"] in ("singles", "controls")


def _pair(o):
    return o["suite"] == "pairs"


def _against_peer(outcomes, who):
    """Ratio to the prototype, which compiles its simulation once before the first log."""
    both = [o["ours"]["seconds"] / o["peer"]["seconds"] for o in outcomes if o["peer"]]
    return f"{np.median(both):.2f}" if both and who == "ours" else "-"


def by_effect(outcomes):
    """Lines: per hidden effect, how many numbers lie inside their intervals, where not all do."""
    counts = {}
    for o in _right(outcomes, "ours"):
        for effect, numbers in o["ours"]["inside"].items():
            for name, ok in numbers.items():
                counts.setdefault(f"{effect}.{name}", []).append(ok)
    return [f"  {k}: {sum(v)}/{len(v)}" for k, v in sorted(counts.items()) if not all(v)]


def confusion(outcomes, who="ours"):
    """Lines: each hidden effect (visible ones) and what was named in its place, with counts."""
    rows = {}
    for o in outcomes:
        if not o[who] or (o["suite"] in ("singles", "one_cell", "pairs") and not visible(o)):
            continue
        v = o[who]
        said = " + ".join(names(v)) or {"adequate": "nothing"}.get(v["verdict"], v["verdict"])
        rows.setdefault(" + ".join(hidden(o)) or "nothing", Counter())[said + (" + ?" if v["remains"] else "")] += 1
    width = max(map(len, rows), default=0)
    return [
        f"{row:{width}} {sum(c.values()):4}: " + ", ".join(f"{name} {n}" for name, n in c.most_common())
        for row, c in sorted(rows.items())
    ]


def missed(o, v):
    """Why a log counts as a miss; empty where it does not."""
    if v["verdict"] == "crashed":
        return "crashed"
    if o["suite"] in ("controls", "absorbed"):
        return "" if quiet(o, v) else "false alarm"
    if o["suite"] == "unknowns":
        if v["named"]:
            return "a cause named"
        return "" if told_unknown(o, v) or not shows(o) else "not said to be unknown"
    if not visible(o):
        return f"not visible, yet {wrong(o, v)} named" if wrong(o, v) else ""
    return ", ".join(_misnamed(o, v) + (_mispredicted(o, v) if right(o, v) else []))


def _misnamed(o, v):
    found = []
    if not set(hidden(o)) <= set(names(v)):
        found.append("not named" if not in_group(o, v) else "only in the group")
    if extra := wrong(o, v):
        found.append(f"wrong {'+'.join(extra)}")
    if o["suite"] != "pairs" and cell_right(o, v) is False:
        found.append("wrong cell")
    return found


def _mispredicted(o, v):
    found = []
    if v["held"][1] > HELD * o["floor"]:
        found.append(f"held-out {v['held'][1] / o['floor']:.2f} x noise")
    if v.get("new_drive") is not None and v["new_drive"] > NEW * o["floor"]:
        found.append(f"new drive {v['new_drive'] / o['floor']:.2f} x noise")
    if v["core"][1] >= v["core"][0]:
        found.append("core worse")
    return found


def misses(outcomes, who="ours"):
    """Lines: every miss."""
    lines = []
    for o in outcomes:
        v = o[who]
        if not v or not (why := missed(o, v)):
            continue
        said = [
            n["effect"] + (f"@{n['cell']}" if n["cell"] else "") + (f" ~{'/'.join(n['tied'])}" if n["tied"] else "")
            for n in v["named"]
        ]
        truth = [None if h["odds"] is None else round(h["odds"], 1) for h in o["hidden"]]
        more = "; ".join(
            f"{e}{f'@{c}' if c else ''} {x}{f' ({r})' if r else ''}" for e, c, x, r in v.get("ranking", ())
        )
        lines.append(
            f"[{o['suite']}] {o['name']}: {why} | {v['verdict']}{' +?' if v['remains'] else ''} {said} | odds of the "
            f"truth {truth}, ranked {more} | structure {v['structure'][0]:.2f} -> {v['structure'][1]:.2f} | held "
            f"{v['held'][0] / o['floor']:.2f} -> {v['held'][1] / o['floor']:.2f} x noise | "
            f"core {v['core'][0]:.2f} -> {v['core'][1]:.2f} K" + (f" | {v['error']}" if "error" in v else "")
        )
    return lines
