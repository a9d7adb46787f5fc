"""Sentences as the page shows them: what an effect is called before its identifier, a true minus sign, no unit of 1."""

import re
from functools import lru_cache
from typing import Final

from bms_gateway.thermal.effects import catalogue

_MINUS: Final = re.compile(r"(?<![\w.)])-(?=\d)")


@lru_cache(1)
def _names() -> tuple[re.Pattern[str], dict[str, str]]:
    titles = {name: e.title for name, e in catalogue().items()}
    keys = "|".join(sorted((n for n in titles if "_" in n), key=len, reverse=True))
    return re.compile(rf"(?<![\w(])({keys})(?::(\d+))?(?![\w:])"), titles


def in_words(text: str) -> str:
    """Write a sentence for people.

    Examples
    --------
    >>> in_words("Missing: entropic_heat: reversible (entropic) heat. At rest -3.7 A; g = 0.02 ± 0.01 1")
    'Missing: reversible (entropic) heat (entropic_heat). At rest −3.7 A; g = 0.02 ± 0.01'
    >>> in_words("It looks like phase_change:2 here.")
    'It looks like latent heat at the surface (phase_change:2) here.'
    """
    pattern, titles = _names()
    for name, title in titles.items():
        text = re.sub(rf"(?<![\w(])({name}(?::\d+)?): {re.escape(title)}", rf"{title} (\1)", text)
    text = pattern.sub(lambda m: f"{titles[m[1]]} ({m[0]})", text)
    return re.sub(r"(± [\d.]+) 1(?=$|;)", r"\1", _MINUS.sub("−", text))
