"""Names of the models on the way from a file to a better model: the same on a terminal, in reports and on the page."""

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


def titled(step: str) -> str:
    """Head what is said of one of these models.

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
