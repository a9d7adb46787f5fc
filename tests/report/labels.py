"""Sentences without the labels of effects: what a page or a terminal says is held against what JSON documents say."""

import re

from bms_gateway.thermal.effects import catalogue


def bare(text: str) -> str:
    """Take the label off each effect that has one, and write minus signs as programs do."""
    text = text.replace("−", "-")
    for name, effect in catalogue().items():
        title = re.escape(effect.title)
        place = r"(?:after )?cell \d+"
        text = re.sub(rf"({name}(?::\d+)?(?: \({place}\))?): {title}", r"\1", text)
        text = re.sub(rf"{title} \(({name}(?::\d+)?), ({place})\)", r"\1 (\2)", text)
        text = re.sub(rf"{title} \(({name}(?::\d+)?)\)", r"\1", text)
    return text
