"""The steps of a session, from the model in its file to the newest one, as all parts of the page name them.

Doubt goes with a step: whether its cores are proven, and whether something unknown remains. A diagnosis that leaves
something open casts doubt on its own model and on all later ones, until a later model is diagnosed. One that is only
read from a session file adds doubt and takes none away, because anybody can change the file.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from bms_gateway.diagnosis.error_words import UNKNOWN, course, falls, rises
from bms_gateway.report.step_names import FILED, REFITTED, titled
from bms_gateway.workbench.commands import Leg

Document = dict[str, Any]
Window = tuple[float, float]
"""First and last value on the axis of a figure."""
SERIES = ".series-"
"""First characters of file names of long series; no upload has such a name."""
TABLES: Final = ("errors", "parameters", "correlations", "thermocouples")
"""HTML of a comparison that is shown with its step; the two steps of the first model share it."""
REMAINS = "Something unknown remains"
UNSETTLED: Final = (
    "By the session file alone, nothing unknown remains: it says so of the model “{}”, and anybody can change it. The "
    "diagnosis must be computed again here."
)


@dataclass(slots=True)
class Frame:
    """One model of the session, and the results from it.

    Attributes
    ----------
    text : str
        Model file.
    label : str
        Name of the step.
    words : list of str
        Effects added to the previous frame, as for `add`.
    drawn : dict
        Its curves in the figures, by the name of the step; the first frame has two steps.
    """

    text: str
    label: str
    words: list[str] = field(default_factory=list)
    forced: bool = False
    told: Document | None = None
    compared: Document | None = None
    figures: dict[str, Document] = field(default_factory=dict)
    drawn: dict[str, dict[str, Document]] = field(default_factory=dict)
    diagnosed: Document | None = None
    curves: dict[str, Document] = field(default_factory=dict)


def steps_of(frames: list[Frame]) -> list[Document]:
    """Return the steps in their order: errors, additions, the model against the readings, and doubt."""
    found: list[Document] = []
    for i, f in enumerate(frames):
        variants = f.compared["variants"] if f.compared else {}
        if i == 0:
            filed = _step(FILED, f, variants.get(FILED), "" if f.compared is None else remains(frames[:1]))
            found.append({**filed, "core": f.compared and UNFITTED})
        if i or f.compared:
            variant = variants.get(f.label)
            one = _step(f.label, f, variant, remains(frames[: i + 1]))
            one |= {"words": f.words, "forced": f.forced, "told": f.told}
            found.append(one)
    for before, after in pairwise(found):
        after["worse"] = _worse(before, after)
    return found


def _worse(before: Document, after: Document) -> str:
    """Say that a step follows the fitted readings less closely than the previous one, and what the held-out ones say.

    Empty if it follows the fitted readings as closely.
    """
    (one, held), (other, held_after) = (
        [(s["stair"] or {}).get(k) for k in ("trained_K", "held_K")] for s in (before, after)
    )
    if one is None or other is None or not rises(one, other):
        return ""
    what = "This refit" if after["name"] == REFITTED else f"The step “{after['name']}”"
    than, fitted = f"{what} is worse than the model {before['name']}", course(one, other, _digits)
    if held is None or held_after is None:
        said = f"{than}: the error where fitted {fitted}."
    elif falls(held, held_after):
        better = course(held, held_after, _digits)
        said = (
            f"{than} where it was fitted, and better where not: the error where fitted {fitted}, held out it {better}."
        )
    else:
        said = f"{than}: the error where fitted {fitted}, held out it {course(held, held_after, _digits)}."
    return f"{said} The model lacks something; its cores are no answer."


def _digits(x: float) -> str:
    return f"{x:.3g}"


def way_of(frames: list[Frame], checks: Sequence[Document]) -> list[Leg]:
    """Return the models of the session for its commands; `checks`: what the direct checks found in the records."""
    fits = not any(c["severity"] == "stop" for c in checks)
    legs = [Leg(f.words, f.forced, f.diagnosed is not None) for f in frames]
    if len(frames) == 1 and frames[0].compared is not None:
        legs[0] = replace(legs[0], refitted="fits" if fits else "refused")
    return legs


def newest_diagnosed(frames: Sequence[Frame]) -> Frame | None:
    """Return the newest diagnosed model: its ranking stays visible while effects are added one by one."""
    return next((f for f in reversed(frames) if f.diagnosed is not None), None)


def recalled_of(frames: Sequence[Frame]) -> Frame | None:
    """Return the newest model whose diagnosis is only read from a session file."""
    return next((f for f in reversed(frames) if f.diagnosed and f.diagnosed.get("recalled")), None)


def reported(top: Frame, frames: list[Frame], ticked: Sequence[int] | None, notes: str) -> Document:
    """Return what a report is made of: its kind, what is left open, and each step with its model file.

    Parameters
    ----------
    top : Frame
        The newest model.
    frames : list of Frame
    ticked : sequence of int or None
        Places of the steps that are ticked on the page; None if all are.
    notes : str
        Notes of a person.
    """
    named = [(frames[0].text, FILED), *((f.text, f.label) for f in frames)]
    seen = newest_diagnosed(frames)
    return {
        "text": top.text,
        "kind": "diagnose" if top.diagnosed else "add" if top.told else "compare",
        "remains": remains(frames),
        "steps": [{"text": t, "name": n, "ticked": ticked is None or k in ticked} for k, (t, n) in enumerate(named)],
        "added": {"words": top.words, "force": top.forced},
        "diagnosed": {"text": seen.text, "name": seen.label} if seen and seen is not top else None,
        "told": [{k: s[k] for k in TOLD} for s in steps_of(frames)],
        "notes": notes,
    }


TOLD: Final = ("name", "stair", "worse", "remains", "forced", "told")
"""What a report says of each step."""


UNFITTED: Final = {
    "proven": False,
    "sd_K": None,
    "centre_sd_K": None,
    "why": ["How well its cores are known is said of the model that was refitted to these records."],
    "sentence": "Core not judged: these are the parameters of the file, which were not fitted to these records.",
}
"""Text on the cores of the model as in its file."""


def _step(name: str, f: Frame, variant: Document | None, left: str) -> Document:
    return {
        "name": name,
        "title": titled(name),
        "words": [],
        "forced": False,
        "told": None,
        "variant": variant,
        "tables": {"of": f.label, **{k: f.compared[k] for k in TABLES}} if f.compared else None,
        "stair": variant["stair"] if variant else f.told["after"] if f.told else None,
        "worse": "",
        "core": _core(f),
        "remains": left,
    }


def _core(f: Frame) -> Document | None:
    """Return what is said of the cores of a model; None before it was compared."""
    return f.compared["core"] if f.compared else f.told["core"] if f.told else None


def remains(frames: list[Frame]) -> str:
    """Say what the newest diagnosis of these models left open, or their addition; empty if nothing is left open.

    A model file carries the second with it, also to those who open it later.
    """
    settled_by_file = ""
    for f in reversed(frames):
        if f.diagnosed is None:
            continue
        if f.diagnosed["remains"]:
            return f"{REMAINS}: the diagnosis of the model “{f.label}” leaves structure that no effect explains."
        if not f.diagnosed.get("recalled"):
            break
        settled_by_file = settled_by_file or f.label
    core = _core(frames[-1])
    if core and UNKNOWN in core["why"]:
        return f"{REMAINS}: the addition to this model left structure that no effect explains."
    return UNSETTLED.format(settled_by_file) if settled_by_file else ""


def doubt_lines(frames: list[Frame]) -> list[str]:
    """Return the doubts about the newest model, for the head of its file; an addition has written those of its own."""
    core = _core(frames[-1])
    said = [core["sentence"], *core["why"]] if core and not core["proven"] else []
    left = remains(frames)
    return [*said, left] if left and UNKNOWN not in said else said


def joined(
    figure: Document, steps: Sequence[tuple[str, bool, Mapping[str, Any]]], more: Sequence[Mapping[str, Any]] = ()
) -> Document:
    """Return a figure with the curves of steps, on axes that contain all of them.

    Parameters
    ----------
    figure : dict
    steps : sequence of (name, whether its cores are proven, what it draws)
        In the order of the session; each keeps its own `span`, for axes that follow the shown curves.
    more : sequence of dict
        Other figures whose `span` the axes must contain too.
    """
    spans: dict[str, list[tuple[float, float]]] = {}
    for one in (figure, *(own for _, _, own in steps), *more):
        for axis, span in one.get("span", {}).items():
            spans.setdefault(axis, []).append(span)
    axes = {
        axis: {**figure["layout"][axis], "range": _padded(min(a for a, _ in found), max(b for _, b in found))}
        for axis, found in spans.items()
    }
    drawn = [{"name": name, "proven": proven, **own} for name, proven, own in steps]
    return {"data": figure["data"], "layout": {**figure["layout"], **axes}, "steps": drawn}


def _padded(low: float, high: float) -> list[float]:
    edge = 0.05 * max(high - low, 0.1)
    return [round(low - edge, 4), round(high + edge, 4)]


def forget(folder: Path, still: Sequence[str] = ()) -> None:
    """Delete the files of a tab, except those that are still shown."""
    for path in folder.glob(f"{SERIES}*"):
        if path.name not in still:
            path.unlink(missing_ok=True)
