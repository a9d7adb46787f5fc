"""What of a verdict may be added: decided by the gate of adding itself, so that no offer is refused afterwards."""

from collections.abc import Sequence
from dataclasses import dataclass

from bms_gateway.diagnosis.adding import Wanted, check_signals, unbelievable, weighed_step
from bms_gateway.diagnosis.diagnosis import Diagnosis
from bms_gateway.diagnosis.record import Record
from bms_gateway.errors import DataError


@dataclass(frozen=True, slots=True)
class Offer:
    """The largest part of the named effects that adding does not refuse.

    Attributes
    ----------
    effects : tuple of str
        Keys as for `add`, to be added at once; empty if none can be added without force.
    left_out : tuple of str
        Named effects that are not offered.
    refused : str
        Why not all named effects are offered; empty if they are.
    """

    effects: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    refused: str = ""

    @property
    def sentence(self) -> str:
        """What cannot be added, and what to do instead; empty if everything named can be."""
        if not self.left_out:
            return ""
        if self.effects:
            rest, them = " and ".join(self.effects), " and ".join(self.left_out)
            return f"Not all of this can be added: {self.refused}. {rest} can be added without {them}."
        return (
            f"Nothing of this can be added without force: {self.refused}. The model stays as it is: record the cells "
            "once more under another load or cooling, and diagnose both records together."
        )


def offer(d: Diagnosis, records: Sequence[Record]) -> Offer:
    """Return what of a verdict `add_effects` accepts.

    Where a part is refused, its effect is left out, and the rest is fitted and judged anew; where no single effect is
    the reason, the one that was named last is left out.

    Parameters
    ----------
    d : Diagnosis
    records : sequence of Record
        Of the diagnosis.
    """
    named = [Wanted(s.candidate.effect, s.candidate.cell) for s in d.selected]
    rest, why = named, ""
    while rest:
        try:
            check_signals(rest, records)
        except DataError as e:
            return Offer((), tuple(w.key for w in named), str(e))
        step = weighed_step(d, rest)
        why = why or step.refused
        if not step.refused:
            break
        kept = [w for w, c in zip(rest, step.added, strict=True) if not unbelievable(step.after, [c])]
        rest = kept if len(kept) < len(rest) else rest[:-1]
    keys = tuple(w.key for w in rest)
    return Offer(keys, tuple(w.key for w in named if w.key not in keys), why)
