"""The READMEs: short where they must be, complete, and without a link or a path that leads nowhere."""

import os
import re
import subprocess
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder

import bms_gateway

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "bms_gateway"
MOST_LINES = 180
GENERATED = {"dist", "build", "node_modules", "__pycache__"}
ASIDE = {"shipped", "__pycache__"}
FENCE = re.compile(r"^( *)```.*?^\1```$", re.M | re.S)
LINK = re.compile(r"\[(?:[^\[\]]|`[^`]*`)*\]\(([^()\s]+)\)")
PATH = re.compile(r"`((?:[\w.-]+/)+[\w.-]*)`")
"""A path that a text names in backticks."""
RESULTS = ("fleet/fleet.", "fleet/logs/")
"""What the command writes into the folder of its example."""
TOPS = ("tests/", "deploy/", "dbc/", "bms_gateway/", ".ci/")
EXTERNAL = ("http:", "https:", "mailto:")


def documents() -> list[Path]:
    """Every Markdown file of the repository that is not in a hidden or generated folder."""
    found = []
    for folder, below, files in os.walk(ROOT):
        below[:] = [d for d in below if not d.startswith(".") and d not in GENERATED]
        found += [Path(folder, f) for f in files if f.endswith(".md")]
    return sorted(found)


def anchors(text: str) -> set[str]:
    """Anchors of the headings, as GitHub makes them: lower case, no punctuation, hyphens for blanks, numbered."""
    found: set[str] = set()
    for title in re.findall(r"^#{1,6} +(.+?) *$", FENCE.sub("", text), re.M):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title).lower()
        slug = re.sub(r"[^\w\- ]", "", plain).replace(" ", "-")
        found.add(slug if slug not in found else next(s for i in range(1, 99) if (s := f"{slug}-{i}") not in found))
    return found


def name(path: Path) -> str:
    """Path of a document from the top, as a test's name."""
    return str(path.relative_to(ROOT))


def test_anchors_are_made_as_on_the_web() -> None:
    text = "# What `fit` and `add` write\n## Same\n## Same\n```sh\n# no heading\n```\n### Power cuts, and (restarts)\n"
    assert anchors(text) == {"what-fit-and-add-write", "same", "same-1", "power-cuts-and-restarts"}


def test_the_first_readme_is_read_at_a_sitting() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= MOST_LINES


@pytest.mark.parametrize("document", documents(), ids=name)
def test_every_link_leads_somewhere(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    broken = []
    for target in LINK.findall(FENCE.sub("", text)):
        if target.startswith(EXTERNAL):
            continue
        file, _, anchor = target.partition("#")
        there = (document.parent / file).resolve() if file else document
        sound = there.is_relative_to(ROOT) and there.exists()
        if sound and anchor:
            sound = there.suffix == ".md" and anchor in anchors(there.read_text(encoding="utf-8"))
        if not sound:
            broken.append(target)
    assert broken == []


@pytest.mark.parametrize("document", documents(), ids=name)
def test_every_path_that_is_named_is_there(document: Path) -> None:
    """From the top, or from the package, where a module may go without its ending: `engine/broadcast`."""
    named = PATH.findall(document.read_text(encoding="utf-8"))
    rooms = tuple(f"{p.name}/" for p in PACKAGE.iterdir() if p.is_dir())
    lost = {p for p in named if p.startswith(TOPS) and not (ROOT / p).exists()}
    modules = {p for p in named if p.startswith(rooms) and not p.startswith(RESULTS) and "NAME" not in p}
    lost |= {p for p in modules if not any((PACKAGE / f"{p}{end}").exists() for end in ("", ".py"))}
    assert lost == set()


def test_every_room_has_its_line_in_the_house_and_no_line_is_without_its_room() -> None:
    text = (PACKAGE / "README.md").read_text(encoding="utf-8")
    table = text.split("## Rooms\n")[1].split("\n## ")[0]
    lines = re.findall(r"^\| \[?`(\w+)`", table, re.M)
    folders = {p.name for p in PACKAGE.iterdir() if p.is_dir()} - ASIDE
    files = {p.stem for p in PACKAGE.glob("*.py") if not p.stem.startswith("__")}
    assert sorted(lines) == sorted(folders | files)
    drawn = re.split(r"[\s|]+", table.split("```")[1].strip())
    assert sorted(drawn) == sorted(folders | files)


def test_the_package_names_every_room() -> None:
    named = set(re.findall(r"`(\w+)`", bms_gateway.__doc__ or ""))
    assert named >= {p.name for p in PACKAGE.iterdir() if p.is_dir()} - ASIDE


def test_every_text_is_reached_from_the_first_one() -> None:
    reached, ahead = set(), [ROOT / "README.md"]
    while ahead:
        document = ahead.pop()
        reached.add(document)
        for target in LINK.findall(FENCE.sub("", document.read_text(encoding="utf-8"))):
            there = (document.parent / target.partition("#")[0]).resolve()
            if there.suffix == ".md" and there not in reached and there.exists():
                ahead.append(there)
    assert set(documents()) - reached == set()


def test_the_wheel_holds_all_that_is_shipped_and_no_text_of_a_checkout() -> None:
    """READMEs link to each other and to the tests, which a wheel does not hold."""
    inside = {f.distribution_path for f in WheelBuilder(str(ROOT)).recurse_included_files()}
    shipped = [*(ROOT / "deploy").rglob("*"), *(ROOT / "dbc").glob("bms_gateway.*")]
    wanted = {f"bms_gateway/shipped/{name(p)}" for p in shipped if p.is_file() and p.suffix != ".md"}
    assert len(wanted) >= 10
    assert wanted - inside == set()
    assert {path for path in inside if path.endswith(".md")} == set()


@pytest.mark.parametrize("block", ["demo", "test"])
def test_the_two_commands_stand_where_they_are_looked_for(block: str) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (command,) = re.findall(rf"^<!-- {block} -->\n```sh\n(.+?)\n```$", text, re.M)
    subprocess.run(["bash", "-n", "-c", command], check=True)
