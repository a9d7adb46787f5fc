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
    # 60 to 20 s without them
    "workbench/test_mailed_session.py",
    "diagnosis/test_record_windows.py",
    "health/test_heat.py",
    "chaos/test_scenarios.py",
    "workbench/test_desk.py",
    "diagnosis/test_coarse_rows.py",
    "engine/test_engine.py",
    "cli/test_one_step.py",
    "setup/test_init.py",
    "library/test_same_numbers.py",
    "observe/test_effects.py",
    "cli/test_road.py",
    # 19 to 8 s
    "cli/test_one_core.py",
    "fleet/test_whole_fleet.py",
    "report/test_html.py",
    "records/test_same_samples.py",
    "diagnosis/test_compare.py",
    "observe/test_adaptive.py",
    "cli/test_alarms.py",
    "identify/test_doubt.py",
    "cli/test_main.py",
    "chaos/test_heat_faults.py",
    "store/test_trial.py",
    "workbench/test_session.py",
    "sensors/test_placement.py",
    "cli/test_encode.py",
    "acceptance/test_race_car.py",
    "cli/test_run.py",
    "engine/test_cells.py",
    "workbench/test_stretch.py",
    "setup/test_write.py",
    "store/test_recent.py",
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
