"""The live page of the example vehicle: its pictures from a log, and a script that holds them back in the browser."""

from bms_gateway.bus.logfile import read_log
from bms_gateway.config import load_config, shipped
from bms_gateway.engine import Engine, drive
from bms_gateway.workbench.live_estimates import Watch

EXAMPLE = "deploy/example/gateway.toml"
LIMIT_C = 80.0
"""Of cores and surfaces, where the config names none."""
CATCH = """
const Own = window.EventSource;
window.EventSource = class extends Own {
  set onmessage(f) {
    super.onmessage = e => {
      if (!this.url.includes('/api/watch')) { f(e); return; }
      window.last ??= JSON.parse(e.data);
      if (!window.held) { window.last = JSON.parse(e.data); f(e); }
    };
    if (this.url.includes('/api/watch')) window.show = p => f({data: JSON.stringify(p)});
  }
};
"""
"""Holds the pictures of the page back, so that a test can show one that it has changed."""


def watched(log):
    """A watch that no tab looks at yet, its engine, and all that the engine says."""
    config = load_config(shipped(EXAMPLE))
    engine = Engine(config.plan, config.database)
    bus = {"received": 0, "dropped": 0, "bits": 0, "link": "log"}
    watch = Watch(engine, "log", "drive.log", 500e3, lambda: bus)
    return watch, engine, drive(engine, read_log(log))
