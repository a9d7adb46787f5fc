"""The steps of the road, from the model in its file to the newest one, as every part of the page names them.

Doubt goes with a step: whether its cores are proven, and whether something unknown remains. A diagnosis that leaves
something open casts doubt on its own model and on all later ones, until a later model is diagnosed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from bms_gateway.report.step_names import FILED, titled

Document = dict[str, Any]
Window = tuple[float, float]
"""First and last value on the axis of a figure."""
SERIES = ".series-"
"""How the names of the files of long series begin; no upload is called so."""
TABLES: Final = ("errors", "parameters", "correlations", "thermocouples")
"""Of a comparison: HTML that is shown with its step; the two steps of the first model share it."""
REMAINS = "Something unknown remains"


@dataclass(slots=True)
class Frame:
    """One model on the way, and what was made of it.

    Attributes
    ----------
    text : str
        Model file.
    label : str
        Name of the step.
    words : list of str
        Effects added to the frame before, as `add` takes them.
    drawn : dict
        What it draws into the figures, by the name of the step; the first frame draws two steps.
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
    """Tell the steps in their order: errors, what was added, the model against the readings, and doubt."""
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
    return found


UNFITTED: Final = {
    "proven": False,
    "sd_K": None,
    "centre_sd_K": None,
    "why": ["How well its cores are known is said of the model that was refitted to these records."],
    "sentence": "Core not judged: these are the parameters of the file, which were not fitted to these records.",
}
"""What there is to say of the cores of the model as it is in its file."""


def _step(name: str, f: Frame, variant: Document | None, left: str) -> Document:
    core = f.compared["core"] if f.compared else f.told["core"] if f.told else None
    return {
        "name": name,
        "title": titled(name),
        "words": [],
        "forced": False,
        "told": None,
        "variant": variant,
        "tables": {"of": f.label, **{k: f.compared[k] for k in TABLES}} if f.compared else None,
        "stair": variant["stair"] if variant else f.told["after"] if f.told else None,
        "core": core,
        "remains": left,
    }


def remains(frames: list[Frame]) -> str:
    """Say what the newest diagnosis of these models left open; empty where there is none, or it left nothing."""
    last = next((f for f in reversed(frames) if f.diagnosed is not None), None)
    if last is None or last.diagnosed is None or not last.diagnosed["remains"]:
        return ""
    return f"{REMAINS}: the diagnosis of the model “{last.label}” leaves structure that no effect explains."


def doubt_lines(frames: list[Frame]) -> list[str]:
    """Say what is to be doubted of the newest model, for the head of its file."""
    core = _step("", frames[-1], None, "")["core"]
    said = [core["sentence"], *core["why"]] if core and not core["proven"] else []
    left = remains(frames)
    return [*said, left] if left else said


def joined(
    figure: Document, steps: Sequence[tuple[str, bool, Mapping[str, Any]]], more: Sequence[Mapping[str, Any]] = ()
) -> Document:
    """Give a figure with what steps draw into it, on axes that hold all of them.

    Parameters
    ----------
    figure : dict
    steps : sequence of (name, whether its cores are proven, what it draws)
        In the order of the road.
    more : sequence of dict
        Other figures whose `span` the axes are to hold too.
    """
    spans: dict[str, list[tuple[float, float]]] = {}
    for one in (figure, *(own for _, _, own in steps), *more):
        for axis, span in one.get("span", {}).items():
            spans.setdefault(axis, []).append(span)
    axes = {
        axis: {**figure["layout"][axis], "range": _padded(min(a for a, _ in found), max(b for _, b in found))}
        for axis, found in spans.items()
    }
    drawn = [
        {"name": name, "proven": proven, **{k: x for k, x in own.items() if k != "span"}} for name, proven, own in steps
    ]
    return {"data": figure["data"], "layout": {**figure["layout"], **axes}, "steps": drawn}


def _padded(low: float, high: float) -> list[float]:
    edge = 0.05 * max(high - low, 0.1)
    return [round(low - edge, 4), round(high + edge, 4)]


def forget(folder: Path, still: Sequence[str] = ()) -> None:
    """Delete the files of a tab, but for those that are still shown."""
    for path in folder.glob(f"{SERIES}*"):
        if path.name not in still:
            path.unlink(missing_ok=True)
