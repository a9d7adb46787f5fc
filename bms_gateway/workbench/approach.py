"""An addition while it is being fitted: errors and curves after every Gauss–Newton step, for display.

It uses the search's functions and baseline, with one effect at its most promising place, and shows each model as close
to the readings as it comes. `add_effects` decides on the final model, its numbers, and whether it is accepted.
"""

from collections.abc import Callable, Iterator, Sequence
from time import monotonic
from typing import Any

import numpy as np

from bms_gateway.diagnosis.adding import Wanted
from bms_gateway.diagnosis.candidates import candidates
from bms_gateway.diagnosis.core_known import known_core
from bms_gateway.diagnosis.diagnosis import Diagnosis
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.record import Record
from bms_gateway.diagnosis.screen import screen
from bms_gateway.diagnosis.search import refit
from bms_gateway.diagnosis.verdict_parts import errors
from bms_gateway.identify.map_fit import MapFit, fitted, refreshed, stacked
from bms_gateway.identify.problem import Problem
from bms_gateway.thermal import StringModel
from bms_gateway.workbench.documents import stair
from bms_gateway.workbench.pictures import preview

STEPS = 10
"""Greatest number of steps of one effect; three to five reach the optimum."""
SEEN = 0.01
"""As a share of the cost: a smaller gain moves no bar by a pixel, and is not shown."""
SETTLED = 1.0
"""Cost, twice the log of the likelihood: a step that gains less was the last one."""
PICTURE_S = 0.25
"""Time between two pictures of the curves: the page draws a few a second."""
POINTS = 3000
"""Points of all curves of one picture together."""
Show = Callable[[dict[str, Any]], None]


def approach(
    model: StringModel,
    records: Sequence[Record],
    wants: Sequence[Wanted],
    known: Diagnosis | None,
    show: Show,
) -> None:
    """Show how the errors fall while effects are fitted.

    Parameters
    ----------
    model : StringModel
    records : sequence of Record
    wants : sequence of Wanted
        Added one after the other.
    known : Diagnosis or None
        For the same model and records, if there is one: replaces the fit without the effects.
    show : callable
        Gets the errors `before` and at present, `after`, in the form of `stair`; and `curves`, by the name of the
        figure, if the last ones are `PICTURE_S` old: present model and residual.
    """
    start = model.unfitted
    base = known.search.baseline if known else fitted(Problem(start, [measured(r, start) for r in records]))
    core = known_core(model, records, known.identified[0] if known else None, known.search if known else None)
    before = stair(errors(core.identified.fit), float(core.half_width_K.max()))
    show({"before": before, "after": before, "curves": preview(base, POINTS)})
    fit, shown, drawn_s = base, base.cost, monotonic()
    told, last = before, base
    for w in wants:
        for step in _steps(fit, w):
            fit = step
            if step.cost < shown - SEEN * abs(shown):
                shown, told, last = step.cost, _stair(step), step
                due = monotonic() > drawn_s + PICTURE_S
                show({"before": before, "after": told} | ({"curves": preview(step, POINTS)} if due else {}))
                drawn_s = monotonic() if due else drawn_s
    if last is not base:
        show({"before": before, "after": told, "curves": preview(last, POINTS)})


def _steps(parent: MapFit, w: Wanted) -> Iterator[MapFit]:
    """Yield the fits on the way to the optimum with one more effect; none if these records cannot show the effect."""
    y = stacked(parent.problem)[0]
    surfaces = float(np.quantile(y, 0.05)), float(np.quantile(y, 0.95))
    offered = candidates(parent.problem.model, parent.problem.records[0].drive, surfaces)
    ways = [c for c in offered if w.meets(c)]
    if not ways:
        return
    fit = refit(parent, screen(parent, ways)[0], iterations=1)
    for _ in range(STEPS):
        if not np.isfinite(fit.cost):
            return
        yield fit
        before, fit = fit.cost, refreshed(fit, iterations=1)
        if before - fit.cost < SETTLED:
            break
    if np.isfinite(fit.cost):
        yield fit


def _stair(fit: MapFit) -> dict[str, Any]:
    return stair(errors(fit), None)  # how well a core is known is judged at the end
