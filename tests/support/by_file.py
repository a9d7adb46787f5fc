"""How the tests are shared out to several workers."""

from functools import cache
from pathlib import Path

from xdist.scheduler import LoadScopeScheduling
from xdist.workermanage import WorkerController

LONGEST = (
    # minutes, with the slow tests
    "diagnosis/test_measured_records.py",
    "acceptance/test_effects_live.py",
    "acceptance/test_pack.py",
    "engine/test_statistics.py",
    "diagnosis/test_hidden_effects.py",
    "workbench/test_robust.py",
    "identify/test_window.py",
    # 48 to 20 s without them
    "diagnosis/test_measured_cells.py",
    "engine/test_engine.py",
    "library/test_same_numbers.py",
    "cli/test_one_core.py",
    "workbench/test_session.py",
    "records/test_same_samples.py",
    "workbench/test_desk.py",
    "engine/test_cells.py",
    "acceptance/test_race_car.py",
    "identify/test_doubt.py",
    "cli/test_export.py",
    # 19 to 10 s
    "acceptance/test_bench_cell.py",
    "cli/test_alarms.py",
    "diagnosis/test_curve.py",
    "cli/test_forecast.py",
    "cli/test_fit_cells.py",
    "identify/test_regression.py",
    "identify/test_inlet_noise.py",
    "chaos/test_heat_faults.py",
    "fleet/test_whole_fleet.py",
    "identify/test_real_cell.py",
)
"""Files that take longest, in the order in which a run begins with them."""


@cache
def shares_vcan0(file: Path) -> bool:
    text = file.read_text(encoding="utf-8")
    return "mark.vcan" in text or "mark.systemd" in text


class ByFile(LoadScopeScheduling):
    """Keeps a file's tests on one worker, for its fixtures, and all files that share the one vcan0 on one.

    xdist's own groups are words put behind a test's id, which pytest 9.2 does not take any more.
    """

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        return "vcan0" if shares_vcan0(Path(self.config.rootpath) / file) else file

    def _assign_work_unit(self, node: WorkerController) -> None:
        """Hand out the files that take longest first, so that no worker ends alone with one of them."""
        self.workqueue.move_to_end(min(self.workqueue, key=_place), last=False)
        super()._assign_work_unit(node)


def _place(scope: str) -> int:
    file = scope.removeprefix("tests/")
    return LONGEST.index(file) if file in LONGEST else len(LONGEST)
