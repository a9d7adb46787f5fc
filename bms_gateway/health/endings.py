"""The sentence of an alert that has ended: why it has ended, and never the words of its last condition alone."""

from collections.abc import Collection, Iterable
from dataclasses import replace
from typing import Final

from bms_gateway.health.alerts import Condition, no_longer

OF_INPUTS: Final = ("sensor", "unheard", "current_sign", "estimate")
"""Conditions that are not judged while the bus is quiet."""
KNOWN_AGAIN: Final = "a core temperature of the string is known to 12 K again"
NAMED: Final = 3  # sentences of inputs that came back together; further ones are counted


class Endings:
    """What has been said of faults that are over, until their alerts end.

    The notices that a flag has ended or that a signal is good again say the reason. They come at the moment at which
    the condition disappears; its alert may end some seconds later.
    """

    def __init__(self) -> None:
        self._said: dict[tuple[str, str, str], dict[int | None, str]] = {}
        self._acknowledged: set[tuple[str, str, int, str]] = set()
        self._present: dict[tuple[str, str, str], str] = {}
        self._quiet = False

    def take(self, name: str, string: str, part: str, cell: int | None, text: str) -> None:
        """Take the sentence by which a fault of this name, string, part and cell has ended."""
        self._said.setdefault((name, string, part), {})[cell] = text

    def acknowledge(self, conditions: Iterable[Condition]) -> None:
        """Take the conditions that a person ends now."""
        self._acknowledged |= {c.key for c in conditions}

    def see(self, conditions: Collection[Condition], *, quiet: bool) -> None:
        """Take the conditions that exist now: what was said of their end before is past."""
        self._quiet, self._present = quiet, {_group(c): c.text for c in conditions}
        if not self._said and not self._acknowledged:
            return
        self._acknowledged -= {c.key for c in conditions}
        for c in conditions:
            if c.name == "sensor":  # one condition for all cells of a quantity
                self._said.pop(_group(c), None)
            else:
                self._said.get(_group(c), {}).pop(c.cell, None)

    def of(self, last: Condition, measured: str = "") -> Condition:
        """Return the condition of an alert that ends now, with the sentence that says why.

        Parameters
        ----------
        last : Condition
            As it was when it last existed.
        measured : str
            Reason that its own judge gives; empty if there is none.
        """
        return replace(last, text=self._why(last, measured))

    def _why(self, c: Condition, measured: str) -> str:
        if c.key in self._acknowledged:
            self._acknowledged.discard(c.key)
            return f"ended by a person, who acknowledged it{'' if c.cell is None else f' (cell {c.cell})'}"
        said = self._said.get(_group(c), {})
        if c.name == "sensor" and said:
            texts = list(said.values())
            more = f" and {len(texts) - NAMED} more" if len(texts) > NAMED else ""
            return "; ".join(texts[:NAMED]) + more
        if (text := said.get(c.cell, said.get(None, ""))) or (text := measured):
            return text
        if (text := self._present.get(_group(c), "")) and c.text:
            return f"goes on as another alert: {text}"
        if c.name in OF_INPUTS and self._quiet:
            return f"not judged while no frames are received; before: {c.text}"
        if c.name == "estimate":
            return KNOWN_AGAIN
        return no_longer(c).text


def _group(c: Condition) -> tuple[str, str, str]:
    return c.name, c.string or "", c.part
