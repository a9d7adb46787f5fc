"""The scripts of the page are all asked for with its HTML: one that is found later costs a round before the picture."""

import re
from importlib.resources import files

PAGE = files("bms_gateway.workbench").joinpath("page")
IMPORTED = re.compile(r'\bfrom "\./([a-z_]+\.js)"')


def imported(name, found):
    """A script and all that it imports, and those in turn."""
    if name not in found:
        found.add(name)
        for other in IMPORTED.findall(PAGE.joinpath(name).read_text(encoding="utf-8")):
            imported(other, found)
    return found


def test_every_script_that_the_page_imports_is_asked_for_at_once():
    html = PAGE.joinpath("page.html").read_text(encoding="utf-8")
    asked = set(re.findall(r'(?:modulepreload" href|script type="module" src)="/page/([a-z_]+\.js)"', html))
    assert asked == imported("main.js", set())
