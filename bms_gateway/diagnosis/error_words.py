"""Words for errors and bands, used wherever a model is judged or compared before and after a step."""

from collections.abc import Callable

LEAST = 0.02
"""Relative change of an error below which it is called unchanged, because no user could act on it."""
WIDE_K = 10.0
"""Half width of a band above which it is given in whole kelvins."""
UNKNOWN = "Something unknown remains beside what was added."
"""A doubt about a model; its file carries the sentence."""


def falls(before: float, after: float) -> bool:
    """Whether an error falls by enough to be called that."""
    return after < (1.0 - LEAST) * before


def rises(before: float, after: float) -> bool:
    """Whether an error rises by enough to be called that."""
    return after > (1.0 + LEAST) * before


def only_fitted(*errors: tuple[float, float] | None) -> bool:
    """Whether the change lowers the error of the fitted readings but none of these errors on held-out readings.

    Each is (before, after), K, or None if it is not known.
    """
    return not any(falls(*e) for e in errors if e is not None)


def course(before: float, after: float, show: Callable[[float], str] = "{:.2g}".format) -> str:
    """Say how an error moved: falls, rises or stays.

    Parameters
    ----------
    before, after : float, K
    show : callable, optional
        Writes a number.

    Examples
    --------
    >>> course(0.4, 0.32)
    'falls from 0.4 to 0.32 K'
    >>> course(0.32, 0.4)
    'rises from 0.32 to 0.4 K'
    >>> course(0.3201, 0.3198)
    'stays at 0.32 K'
    """
    one, other = show(before), show(after)
    if falls(before, after) and one != other:
        return f"falls from {one} to {other} K"
    if rises(before, after) and one != other:
        return f"rises from {one} to {other} K"
    return f"stays at {other} K"


def half_width(half_K: float) -> str:
    """Write the half width of a band, K, to no more digits than a band has a meaning.

    Examples
    --------
    >>> half_width(1.404), half_width(35.28)
    ('1.40', '35')
    """
    return f"{half_K:.{2 if half_K < WIDE_K else 0}f}"


def why_not(before: float, after: float) -> str:
    """Say why effects that do not explain the readings are refused, by the error of the closest fits before and after.

    Examples
    --------
    >>> why_not(0.4, 0.3)
    'it explains a part only: closely fitted, the error falls from 0.4 to 0.3 K'
    >>> why_not(0.4, 0.5)
    'it makes it worse: closely fitted, the error rises from 0.4 to 0.5 K'
    >>> why_not(0.4, 0.4)
    'it changes nothing: closely fitted, the error stays at 0.4 K'
    """
    what = "makes it worse" if rises(before, after) else "explains a part only"
    what = what if rises(before, after) or falls(before, after) else "changes nothing"
    return f"it {what}: closely fitted, the error {course(before, after)}"
