"""Names of the models on the way from a file to a better model: the same on the page and in its reports."""

from typing import Final

FILED: Final = "from its file"
REFITTED: Final = "refitted"
"""The first two; those that follow are named by what was added."""


def with_added(names: str) -> str:
    """Name the model to which something was added.

    Examples
    --------
    >>> with_added("reversible (entropic) heat (entropic_heat)")
    '+ reversible (entropic) heat (entropic_heat)'
    """
    return f"+ {names}"
