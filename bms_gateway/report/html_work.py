"""What a person has done on the page before a report is made: the steps, the newest diagnosis and the notes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from bms_gateway.report.diagnosis_text import Told
from bms_gateway.report.html_ranking import ranking_table
from bms_gateway.report.page import amount, items, paragraph, section
from bms_gateway.report.words import in_words


@dataclass(frozen=True, slots=True)
class Work:
    """See the module's text; a report of a command has none.

    Attributes
    ----------
    steps : sequence of mapping
        The steps as on the page, from `workbench.steps`.
    notes : str
        Notes of a person.
    told : Told or None
        The newest diagnosis, if the report itself is not of a diagnosis.
    tag : str
        Its verdict in a few words.
    of : str
        Name of the step that was diagnosed.
    """

    steps: Sequence[Mapping[str, Any]] = ()
    notes: str = ""
    told: Told | None = None
    tag: str = ""
    of: str = ""

    @property
    def verdict(self) -> str:
        """The verdict of the diagnosis, for the head of the report."""
        if self.told is None:
            return ""
        verdict = self.told.diagnosis.verdict if self.told.diagnosis else "insufficient_data"
        offer = self.told.offer.sentence
        return (
            f'<p id="diagnosed"><span class="tag {verdict}">{escape(self.tag)}</span> '
            f"{escape(f'Diagnosis of the model “{self.of}”:')} {escape(in_words(self.told.sentence))}</p>"
            + (paragraph(offer) if offer else "")
        )

    @property
    def first(self) -> list[str]:
        """Notes and steps, which stand before the pictures."""
        notes = f'<p class="notes">{escape(self.notes)}</p>' if self.notes.strip() else ""
        way = "\n".join(f"<li>{_step(s)}</li>" for s in self.steps)
        return [
            section("written", "Notes", notes),
            section("steps", "The steps", f'<ol class="way">\n{way}\n</ol>' if way else ""),
        ]

    @property
    def ranking(self) -> list[str]:
        """The ranking of the diagnosis, what absorbs its effects, and what to measure next."""
        if self.told is None:
            return []
        d = self.told.diagnosis
        second = d is not None and d.decided_by_second
        following = self.told.next_experiment
        return [
            section(
                "ranking",
                f"What the model “{self.of}” could lack, ranked",
                ranking_table(self.told.ranking, second=second) if d else "",
            ),
            section("absorbed", "What a parameter absorbs", items(self.told.absorbed)),
            section("next", "What to measure next", paragraph(following) if following else ""),
        ]


def _step(s: Mapping[str, Any]) -> str:
    """Return one step: its errors, and what is said of it."""
    stair, told = s["stair"], s["told"]
    lines = [f"<b>{escape(s['name'])}</b>"]
    if stair:
        core = "not known" if not stair["core_known"] else f"± {_number(stair['core_K'])} K (95 %)"
        errors = f"where fitted {_number(stair['trained_K'])} K, held out {_number(stair['held_K'])} K"
        lines.append(escape(f"Error {errors}; least certain core {core}"))
    lines += [f'<span class="danger">{escape(s["worse"])}</span>'] if s["worse"] else []
    lines += [f'<span class="alarm">{escape(s["remains"])}</span>'] if s["remains"] else []
    if told:
        lines.append(escape(told["headline"]))
        doubts = [] if told["core"]["proven"] else [f"{told['tag']}. {told['core']['sentence']}"]
        doubts += [f"Though: {told['refused']}."] if s["forced"] and told["core"]["proven"] else []
        lines += [f'<span class="alarm">{escape(text)}</span>' for text in doubts]
        lines += [escape(told["remark"])] if told["remark"] else []
    return "<br>".join(lines)


def _number(x: float | None) -> str:
    return "–" if x is None else amount(x)
