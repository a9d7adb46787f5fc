"""Names of the models from that of the file to the improved one: the same on a terminal, in reports and on the page."""

from typing import Final

FILED: Final = "from its file"
REFITTED: Final = "refitted"
"""The first two; further ones are named after their additions."""


def with_added(names: str, *, forced: bool = False) -> str:
    """Name the model with an addition, and say whether it was made by force.

    Examples
    --------
    >>> with_added("reversible (entropic) heat (entropic_heat)")
    '+ reversible (entropic) heat (entropic_heat)'
    >>> with_added("end plates cool or warm the end cells (end_plate)", forced=True)
    '+ end plates cool or warm the end cells (end_plate), by force'
    """
    return f"+ {names}, by force" if forced else f"+ {names}"


def titled(step: str) -> str:
    """Return the heading for one of these models.

    Examples
    --------
    >>> titled(FILED), titled(REFITTED)
    ('The model with the parameters from its file', 'The same model, refitted to these data')
    >>> titled("+ coolant arrives late (coolant_delay)")
    'The model + coolant arrives late (coolant_delay)'
    """
    return {FILED: f"The model with the parameters {FILED}", REFITTED: f"The same model, {REFITTED} to these data"}.get(
        step, f"The model {step}"
    )
