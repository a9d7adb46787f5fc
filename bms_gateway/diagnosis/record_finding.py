"""One finding of the checks of a record."""

from dataclasses import dataclass
from typing import Literal

Severity = Literal["stop", "warn", "note"]
"""Nothing can be learnt; something is probably wrong; a limit worth knowing."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding.

    Attributes
    ----------
    kind : str
        Fixed word for programs.
    severity : {"stop", "warn", "note"}
    sentence : str
        For people.
    """

    kind: str
    severity: Severity
    sentence: str
