"""Collects the first core temperatures of a new vehicle from the engine's estimates, and draws them."""

import importlib.util
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bms_gateway.engine.events import Estimated, Parameters
from bms_gateway.report.hottest import Hottest, hotter, hottest_core
from bms_gateway.thermal import Floats
from bms_gateway.whole import whole

FEWEST_POINTS = 2
MOST_POINTS = 4000
SETTLING_S = 60.0
"""Time after the first estimate in which the cores still depend on the assumed start."""


@dataclass(slots=True)
class Cores:
    """The hottest core and the range of the surfaces at each tick.

    Attributes
    ----------
    hottest : Hottest or None
        Of the log, from `SETTLING_S` after the first estimate on.
    last : Estimated or None
        The last tick at which a core was known; the last tick if no core was ever known.
    unknown_s : float
        Time from `last` to the end.
    fitted_ns : list of int
        Times at which a fit gave new parameters; the estimates step there.
    """

    last: Estimated | None = None
    unknown_s: float = 0.0
    hottest: Hottest | None = None
    time_ns: list[int] = field(default_factory=list)
    rows: list[tuple[float, float, float, float]] = field(default_factory=list)
    fitted_ns: list[int] = field(default_factory=list)

    def learn(self, p: Parameters) -> None:
        """Record new parameters; those before the first estimate come from the file."""
        if self.time_ns and p.time_ns > self.time_ns[0] and p.time_ns not in self.fitted_ns:
            self.fitted_ns.append(p.time_ns)

    def take(self, e: Estimated) -> None:
        """Record one tick."""
        known = bool(np.isfinite(e.core).any())
        if known or self.last is None or not self.rows:
            self.last = e
        self.unknown_s = (e.time_ns - self.last.time_ns) * 1e-9
        if not known:
            return
        now: Hottest | None = None
        for cells in e.strings():
            now = hotter(now, hottest_core(cells, cells.core))
        if now is None:
            return
        self.time_ns.append(e.time_ns)
        surface = e.surface[np.isfinite(e.surface)]
        warmest, coolest = (float(surface.max()), float(surface.min())) if len(surface) else (np.nan, np.nan)
        self.rows.append((now.core_C, now.core_sd_K, warmest, coolest))
        if (e.time_ns - self.time_ns[0]) * 1e-9 >= SETTLING_S:
            self.hottest = hotter(self.hottest, now)


def no_picture(cores: Cores) -> str:
    """Say why there is no picture: too few cores are known, which no extra changes, or the extra is missing."""
    if not cores.rows:
        return "no picture: in this log no core is known at any time, so there is nothing to draw"
    if len(cores.rows) < FEWEST_POINTS:
        return "no picture: a core is known at one second of this log only"
    return "a picture of the cores needs the extra report: pip install 'bms-gateway[report]'"


def draw(cores: Cores, path: Path) -> Path | None:
    """Draw hottest core with its band, the range of the surfaces and the times of fits.

    None without the extra, or without estimates; `no_picture` says which.
    """
    if importlib.util.find_spec("matplotlib") is None or len(cores.rows) < FEWEST_POINTS:
        return None
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    step = max(len(cores.rows) // MOST_POINTS, 1)
    t: Floats = (np.array(cores.time_ns[::step]) - cores.time_ns[0]) * 1e-9
    core, sd, warmest, coolest = np.array(cores.rows[::step]).T
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    if np.isfinite(coolest).any():  # all may be stuck
        axes.fill_between(t, coolest, warmest, color="0.8", label="surfaces")
    axes.fill_between(t, core - 2 * sd, core + 2 * sd, color="tab:red", alpha=0.2, label="± 2 sd")
    axes.plot(t, core, color="tab:red", label="hottest core")
    for k, fitted in enumerate(cores.fitted_ns):
        label = None if k else "a fit gives new parameters"
        axes.axvline((fitted - cores.time_ns[0]) * 1e-9, color="0.3", linestyle=":", linewidth=1, label=label)
    axes.set_xlabel("time, s")
    axes.set_ylabel("temperature, °C")
    axes.legend(loc="best")
    with whole(path) as file:
        figure.savefig(file, format="png", dpi=120)
    return path
