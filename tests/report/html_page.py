"""What stands on the page of a report, read without the code that wrote it."""

import base64
import json
import lzma
import re
from html.parser import HTMLParser

VOID = {"meta", "br", "img", "link", "input", "hr"}


class Page(HTMLParser):
    """What stands on a page; complains about tags that are not closed in order."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.ids, self.open, self.tables, self.text = [], [], [], {}, ""
        self.section = None
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.tags.append((tag, attrs))
        self.ids += [attrs["id"]] if "id" in attrs else []
        if tag not in VOID:
            self.open.append(tag)
        if tag == "section":
            self.section = attrs["id"]
        if tag == "table":
            self.tables.setdefault(self.section, []).append([])
        if tag == "tr":
            self.tables[self.section][-1].append([])
        if tag in ("td", "th"):
            self.tables[self.section][-1][-1].append("")

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("script", "style"):
            return
        self.text += data
        if "td" in self.open or "th" in self.open:
            self.tables[self.section][-1][-1][-1] += data

    def figures(self, text):
        names = [a["id"] for t, a in self.tags if a.get("class") == "plot"]
        all_of_them = json.loads(unpacked(text, "figures")) if names else {}
        assert list(all_of_them) == names
        for trace in (t for f in all_of_them.values() for t in f["data"]):
            trace.update({k: added_up(trace[k]) for k in ("x", "y") if k in trace})
        return all_of_them


def added_up(values):
    """Numbers that are written as their steps."""
    if not isinstance(values, dict):
        return values
    found, whole = [], 0
    for step in values["steps"]:
        whole += step or 0
        found.append(None if step is None else whole / 10 ** values["digits"])
    return found


def unpacked(text, name):
    """What an element holds packed: LZMA by the standard library, told here what a page is to hold."""
    length, packed = re.search(
        f'type="application/x-lzma" id="{name}" data-length="([0-9]+)">(.*?)</script>', text
    ).groups()
    content = lzma.decompress(
        base64.b85decode(packed.replace(",", "<")),
        lzma.FORMAT_RAW,
        filters=[{"id": lzma.FILTER_LZMA1, "lc": 3, "lp": 0, "pb": 0}],
    )
    assert len(content) == int(length)
    return content
