"""Fields show what they hold, a table that is wider than its place says so, and times of the past stand still."""

import json
from datetime import datetime

import numpy as np
import pytest

from bms_gateway.bus.logfile import write_log
from bms_gateway.config import load_config, shipped
from bms_gateway.engine import Engine
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.workbench.live_estimates import Watch
from bms_gateway.workbench.sources import Playback
from tests.support.page_steps import FIT_S, seen_compared
from tests.support.vehicle_traffic import traffic
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import come
from tests.workbench.conftest import served

pytestmark = pytest.mark.slow  # a browser
EXAMPLE = "deploy/example/gateway.toml"
BEGAN_NS = 1_700_000_000_957_000_000
"""Wall clock of the log's first frame, shortly before a full second."""
WHOLE = "const e = document.querySelector(arguments[0]); return e.scrollWidth <= e.clientWidth"
WIDE = """
return [...document.querySelectorAll('.scroll')].filter(e => e.getClientRects().length)
  .map(e => [e.scrollWidth > e.clientWidth + 1, getComputedStyle(e, '::before').content.includes('scrolls sideways'),
  e.ariaLabel]);
"""
TIMES = """
const { when } = await import('/page/util.js');
return arguments[0].map(p => [when(p, 12.3), when(p, 12.0)]);
"""


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    frames = traffic(120.0)
    path = tmp_path_factory.mktemp("log") / "drive.log"
    write_log(path, [FrameBatch(frames.time_ns + BEGAN_NS, frames.can_id, frames.length, frames.data)])
    return path


def test_the_time_of_an_event_is_the_same_in_every_picture(window, log, tmp_path):
    """It wavered by a second from one picture to the next while a log was played."""
    config = load_config(shipped(EXAMPLE))
    engine, source = Engine(config.plan, config.database), Playback([log])
    watch = Watch(engine, "log", log.name, 500e3, source.traffic)
    source.start(engine, watch)
    come(lambda: watch.whole, "the end of the log")
    pictures = []
    for seek in np.arange(20.0, 60.0, 1.37):
        watch.steer("test", {"play": False, "seek": float(seek)})
        pictures.append(json.loads(next(watch.stream("test"))))
    watch.signals.close()
    assert len({p["at"] for p in pictures}) == len(pictures)
    with served(tmp_path) as url:
        page = window(url)
        page.idle()
        told = page.run(TIMES, pictures)
    first_s = pictures[0]["first_s"]
    expected = [datetime.fromtimestamp(first_s + at).strftime("%Y-%m-%d %H:%M:%S") for at in (12.3, 12.0)]
    assert {tuple(t) for t in told} == {tuple(expected)}


@pytest.mark.parametrize("width", [390, 1280])
def test_the_ends_of_a_stretch_are_shown_whole(window, log, tmp_path, width):
    with served(tmp_path, "--live", log, "--config", shipped(EXAMPLE)) as url:
        page = window(url, (width, 800))
        page.wait("return document.querySelector('#play') && !document.querySelector('#live-state').innerText")
        page.wait("return document.querySelector('#past-from')?.value.length === 19")
        for end in ("#past-from", "#past-to"):
            assert page.run(WHOLE, end), end
        assert page.run("return document.documentElement.scrollWidth <= innerWidth")


def test_places_of_cursors_are_whole_and_wide_tables_say_so(window, tmp_path):
    pack = make_pack(tmp_path, seconds=800)
    with served(tmp_path, *pack.words) as url:
        page = window(url, (390, 800))
        seen_compared(page)
        page.idle(FIT_S)
        page.click("#tab-compare")
        page.run("document.querySelectorAll('details').forEach(d => { d.open = true; })")
        page.wait("return document.querySelector('.scroll.more')")
        page.idle(FIT_S)
        found = page.run(WIDE)
        assert len(found) >= 3
        assert [True, True] in [x[:2] for x in found]
        assert [x for x in found if x[0] != x[1]] == []
        page.wait("return document.querySelector('#cursor-a-at').value")
        page.run("const e = document.querySelector('#cursor-a-at'); e.value = '305.013333'")
        assert page.run(WHOLE, "#cursor-a-at")
        assert page.complaints() == []
