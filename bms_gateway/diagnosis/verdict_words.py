"""The sentences of a verdict."""

from collections.abc import Callable, Sequence

from bms_gateway.diagnosis.candidates import Candidate
from bms_gateway.diagnosis.error_words import course, falls, only_fitted
from bms_gateway.diagnosis.verdict_parts import Errors, Selected

BY_NUMBERS = 0.5
"""Share of the error below which other numbers alone must bring it to be mentioned."""


def named(c: Candidate) -> str:
    """Return an effect as a sentence names it."""
    place = "" if c.cell is None else f" (cell {c.cell})" if c.effect.place != "gap" else f" (after cell {c.cell})"
    return f"{c.name}{place}: {c.effect.title}"


def nothing_missing(base: Errors, after: Errors, closest: Errors) -> str:  # noqa: ARG001 - as of the other verdicts
    """Say that the model is adequate; `closest` are the errors of the judged fit."""
    apart = falls(base.heldout_rmse_K, closest.heldout_rmse_K)
    own = f" The numbers that are stated are held near what was known and leave {base.heldout_rmse_K:.2g} K."
    return (
        f"The model explains these readings: {(closest if apart else base).heldout_rmse_K:.2g} K on held-out blocks"
        f"{', where it comes closest to them' if apart else ''}, noise {base.noise_floor_K:.2g} K. "
        f"Nothing is missing that they could show.{own if apart else ''}"
    )


def something_unknown(base: Errors, after: Errors, looks: Sequence[str]) -> str:  # noqa: ARG001 - as above
    """Say that an effect outside the catalogue is missing; `looks` are similar effects."""
    numbers = f" Other numbers of the same model leave {base.closest_K:.2g} K." if _by_numbers(base) else ""
    like = f" It looks partly like {', '.join(looks)}, but that does not explain it." if looks else ""
    return (
        f"Something is missing that no effect of the catalogue explains: {base.heldout_rmse_K:.2g} K on "
        f"held-out blocks, noise {base.noise_floor_K:.2g} K.{numbers}{like}"
    )


def missing(
    base: Errors,
    after: Errors,
    *,
    selected: Sequence[Selected],
    remains: bool,
    undecided: bool = False,
    known_K: tuple[float, float] | None = None,
) -> str:
    """Say which effects are missing, what they do to the error on held-out blocks, and whether more is unknown.

    Of a model file that is far off, other numbers and not the effects remove the most: that is said too.
    """
    held = base.heldout_rmse_K, after.heldout_rmse_K
    names = " and ".join(named(s.candidate) for s in selected)
    them = "it" if len(selected) == 1 else "them"
    lead = "Perhaps missing" if only_fitted(held, known_K) else "Missing"
    if undecided:
        lead = "Something is missing, and these readings do not decide what. The likeliest"
    noise = f"(noise {base.noise_floor_K:.2g} K)"
    text = f"{lead}: {names}. With {them} the error on held-out blocks {course(*held)} {noise}."
    text += by_numbers(base, len(selected))
    if not falls(*held) and known_K is not None and falls(*known_K):
        text += (
            " A part of them holds charge that no other reading covers, so that a law of the charge is only guessed "
            f"there; elsewhere it {course(*known_K)}."
        )
    elif not falls(*held):
        text += f" These readings speak for {them} only where {'it was' if len(selected) == 1 else 'they were'} fitted."
    for s in selected:
        if s.bound:
            text += f" {s.bound}, which is no proof of {s.candidate.key}: another cause may be behind it."
        if s.tied_with:
            text += f" These readings cannot tell {s.candidate.key} from {', '.join(alternatives(s.tied_with))}."
    return text + (" Something unknown remains." if remains else "")


def by_numbers(base: Errors, effects: int, show: Callable[[float], str] = "{:.2g}".format) -> str:
    """Say what other numbers of a model do without so many effects; empty if they do little. `show` writes a number."""
    them = "it" if effects == 1 else "them"
    said = f" Without {them}, other numbers of the same model leave {show(base.closest_K)} K."
    return said if _by_numbers(base) else ""


def _by_numbers(base: Errors) -> bool:
    return base.closest_K < BY_NUMBERS * base.heldout_rmse_K


def alternatives(keys: Sequence[str]) -> list[str]:
    """List effects that look alike; an effect of more than three cells is listed once.

    >>> alternatives(["core_loss", "cell_cooling:1", "cell_cooling:2", "cell_cooling:3", "cell_cooling:4"])
    ['core_loss', 'cell_cooling (4 cells)']
    """
    cells: dict[str, list[str]] = {}
    for key in dict.fromkeys(keys):
        cells.setdefault(key.partition(":")[0], []).append(key)
    return [
        word for name, each in cells.items() for word in (each if len(each) <= 3 else [f"{name} ({len(each)} cells)"])
    ]
