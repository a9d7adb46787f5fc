"""Workbench: first picture, zoom of one hour and of ten, the bar of a long diagnosis, what the live page costs.

`python -m tests.benchmarks.bench_workbench`. The browser is real; the live bus is a socket pair under the real port,
fed by another process, in its own time.
"""

import asyncio
import json
import os
import re
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit

from bms_gateway.bus.canframe import to_wire
from bms_gateway.bus.socketcan import SocketCanPort
from bms_gateway.config import load_config, shipped
from bms_gateway.engine import Engine
from bms_gateway.service.live import Gateway
from bms_gateway.workbench.desk import Desk
from bms_gateway.workbench.live_estimates import Watch
from bms_gateway.workbench.server import Server
from bms_gateway.workbench.site import Site
from bms_gateway.workbench.sources import Listening
from tests.support.vehicle_traffic import traffic
from tests.truth.hidden import Scenario, make_logs
from tests.workbench.browser import Driver, Window, why_none

ROUNDS = 7
ZOOM = """const plot = document.querySelector('#plot-surface'), per = Number(plot.dataset.per || 1);
Plotly.relayout(plot, {'xaxis.range': arguments[0].map((x) => x * per)});"""
"""The axis of a stretch has the unit of its length, `per` times that of the whole record."""
ZOOMED = """const shown = (document.querySelector('#stage').dataset.window ?? "").split(",").map(Number);
return shown.length === 2 && shown.every((v, k) => Math.abs(v - arguments[0][k]) < 1e-4);"""
ROWS = """const plot = document.querySelector('#plot-surface'), per = Number(plot.dataset.per || 1);
return plot.data[0].x.filter((v) => v / per >= arguments[0] - 1e-6 && v / per < arguments[1] - 1e-6).length;"""
LIVE_S, OPEN_S = 30.0, 300.0


def written(folder: Path, cells: int, seconds: int) -> list[str | Path]:
    """Write a drive and its model; gives the words that open them."""
    scenario = Scenario(
        {"resistance_temperature": ("strong", None)}, cells=cells, sensors=tuple(range(1, cells + 1)), seconds=seconds
    )
    (log,) = make_logs([scenario])
    log.write_csv(folder / "drive.csv")
    (folder / "pack.toml").write_text(log.model)
    return ["workbench", "--port", "0", folder / "drive.csv", "--model", folder / "pack.toml"]


def zoomed(page: Window, server: int, low: float, high: float) -> tuple[float, float]:
    """Zoom the picture of a surface; gives the time that it took, s, and the server's part of it, CPU-s."""
    before = used_s(server)
    page.run(ZOOM, [low, high])
    page.wait(ZOOMED, [low, high])
    took = int(page.run("return document.querySelector('#stage').dataset.resampledMs")) / 1e3
    return took, used_s(server) - before


def used_s(pid: int) -> float:
    """CPU time of a process without its children, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def opened(driver: Driver, words: Sequence[str | Path]) -> Iterator[tuple[Window, int]]:
    """Start the program and open its page; wait until it can be zoomed. Gives the page and the server's process."""
    page = driver.window("about:blank")
    command = [sys.executable, "-m", "bms_gateway", *map(str, words)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        url = re.search(r"http://\S+", process.stdout.readline())[0]
        time.sleep(2.0)  # a person types the address or follows the link
        page.go(url)
        page.wait("return document.documentElement.dataset.firstPlot", patience_s=OPEN_S)
        yield page, process.pid
    finally:
        driver.windows.pop().close()
        process.terminate()
        process.wait()
        process.stdout.close()


def pictures(driver: Driver, folder: Path) -> tuple[list[float], list[float], list[float]]:
    """Times to the measured curve, to the plot that can be zoomed, and of zooms to a minute, s."""
    words = written(folder, 12, 3600)
    curves, plots, zooms = [], [], []
    for _ in range(ROUNDS):
        with opened(driver, words) as (page, server):
            for times, name in ((curves, "firstPicture"), (plots, "firstPlot")):
                times.append(int(page.run("return document.documentElement.dataset[arguments[0]]", name)) / 1e3)
            zooms += [zoomed(page, server, minute, minute + 1)[0] for minute in (5, 6, 7)]
    return curves, plots, zooms


def ten_hours(driver: Driver, folder: Path) -> tuple[list[float], list[float], list[int]]:
    """Times of zooms of ten hours of sixty cells to a minute, s; the server's part, CPU-s; the rows that are seen."""
    words = written(folder, 60, 36_000)
    zooms, parts, rows = [], [], []
    with opened(driver, words) as (page, server):
        for hour in range(1, 10):
            took, part = zoomed(page, server, hour, hour + 1.0 / 60.0)
            zooms.append(took)
            parts.append(part)
            rows.append(int(page.run(ROWS, hour, hour + 1.0 / 60.0)))
    return zooms, parts, rows


def still(folder: Path) -> tuple[float, float]:
    """Longest time for which the bar of a diagnosis of sixty cells does not move, and the whole time, s."""
    written(folder, 60, 1500)
    desk = Desk("bench")
    try:
        desk.open({"tables": [str(folder / "drive.csv")], "model": str(folder / "pack.toml"), "columns": []})
        while desk.state()["job"]:
            time.sleep(0.1)
        desk.diagnose()
        began = moved = time.monotonic()
        longest, share = 0.0, -1.0
        while job := desk.state()["job"]:
            if job["share"] != share:
                share, longest, moved = job["share"], max(longest, time.monotonic() - moved), time.monotonic()
            time.sleep(0.05)
        if problem := desk.state()["error"]:
            raise RuntimeError(problem)
        return max(longest, time.monotonic() - moved), time.monotonic() - began
    finally:
        desk.close()


def feed(sock: socket.socket, seconds: float) -> None:
    """Send a pack's traffic with its own timing."""
    frames = traffic(seconds + 5.0)
    began, first = time.monotonic_ns(), int(frames.time_ns[0])
    for k in range(len(frames)):
        wait = int(frames.time_ns[k]) - first - (time.monotonic_ns() - began)
        if wait > 0:
            time.sleep(wait * 1e-9)
        sock.send(to_wire(frames[k : k + 1])[0])


def live(watched: bool) -> tuple[float, float]:
    """Share of a core that the program takes, %, and pictures a second, with a page open or not."""
    loaded = load_config(shipped("deploy/example/gateway.toml"))
    engine = Engine(replace(loaded.plan, transmit=False), loaded.database)
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    pid = os.fork()
    if pid == 0:
        feed(theirs, LIVE_S)
        os._exit(0)
    port = Listening(SocketCanPort.over(ours))
    watch = Watch(engine, "live", "pair", 500e3, port.traffic)
    server = Server(Site(watch=watch), "127.0.0.1", 0)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    reader = None
    if watched:  # in a process of its own: reading is the browser's work
        command = [sys.executable, "-c", READER, urlsplit(server.door.url).netloc, str(LIVE_S - 2.0)]
        reader = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    before = time.process_time()
    asyncio.run(Gateway(engine, port, watch=watch.take).run(seconds=LIVE_S))
    used = time.process_time() - before
    server.site.close()
    server.shutdown()
    server.server_close()
    os.kill(pid, 9)
    os.waitpid(pid, 0)
    seen = float(reader.communicate()[0]) if reader else 0.0
    return 100.0 * used / LIVE_S, seen


READER = """
import http.client, sys, time
c = http.client.HTTPConnection(sys.argv[1], timeout=60)
c.request("GET", "/api/watch?view=bench")
r, n, end, began = c.getresponse(), 0, time.monotonic() + float(sys.argv[2]), time.monotonic()
while time.monotonic() < end:
    n += r.readline().startswith(b"data:")
print(n / (time.monotonic() - began))
"""


def _spread(found: Sequence[float]) -> str:
    return f"median {statistics.median(found):.2f} s, {min(found):.2f} to {max(found):.2f} s"


def main() -> None:
    """Print all figures."""
    result: dict[str, object] = {}
    bare, _ = live(False)
    with_page, shown = live(True)
    print(f"live, 60 cells: {bare:.1f} % of a core without a page, {with_page:.1f} % with one; {shown:.2f} pictures/s")
    result["live"] = {"bare_pct": bare, "with_page_pct": with_page, "pictures_per_s": shown}
    with tempfile.TemporaryDirectory() as folder:
        longest, whole = still(Path(folder))
    print(f"diagnosis of sixty cells, 25 min: the bar stands for {longest:.1f} s of {whole:.0f} s at most", flush=True)
    result["bar_stands_s"], result["bar_s"] = longest, whole
    if why := why_none():
        print(f"first picture: {why}")
    else:
        with tempfile.TemporaryDirectory() as folder:
            driver = Driver(Path(folder))
            try:
                curves, plots, zooms = pictures(driver, Path(folder))
                for what, found in (("first picture", curves), ("to be zoomed", plots), ("a zoom to a minute", zooms)):
                    print(f"{what}, 1 h of 12 cells: {_spread(found)}", flush=True)
                long_zooms, parts, rows = ten_hours(driver, Path(folder))
            finally:
                driver.close()
        print(f"a zoom to a minute, 10 h of 60 cells: {_spread(long_zooms)}; {min(rows)} rows seen of 60")
        print(f"the server's part of it: {_spread(parts)} of a core")
        result["first_picture_s"], result["first_plot_s"], result["zoom_s"] = curves, plots, zooms
        result["long_zoom_s"], result["long_zoom_rows"] = long_zooms, rows
    print(json.dumps(result))


if __name__ == "__main__":
    main()
