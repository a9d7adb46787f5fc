"""How the tests are shared out to several workers."""

from functools import cache
from pathlib import Path

from xdist.scheduler import LoadScopeScheduling
from xdist.workermanage import WorkerController

LONGEST = (
    # minutes, with the slow tests
    "diagnosis/test_measured_records.py",
    "workbench/test_mailed_session.py",
    "cli/test_one_step.py",
    "acceptance/test_effects_live.py",
    "acceptance/test_pack.py",
    "engine/test_statistics.py",
    "diagnosis/test_hidden_effects.py",
    "workbench/test_robust.py",
    "identify/test_window.py",
    # longest without them
    "workbench/test_desk.py",
    "health/test_heat.py",
    "diagnosis/test_record_windows.py",
    "cli/test_one_core.py",
    "chaos/test_scenarios.py",
    "cli/test_road.py",
    "engine/test_engine.py",
    "diagnosis/test_compare.py",
    "report/test_html.py",
    "frames/test_encode.py",
    "fleet/test_whole_fleet.py",
    "setup/test_asking.py",
    "observe/test_adaptive.py",
    "observe/test_effects.py",
    "service/test_fit_process.py",
    "engine/test_parked.py",
    "workbench/test_clicks.py",
    "library/test_same_numbers.py",
    "store/test_recent.py",
    "store/test_trial.py",
    "sensors/test_placement.py",
    "workbench/test_whiteness.py",
    "frames/test_dbc_lint.py",
    "identify/test_resistance_by_cell.py",
    "setup/test_init.py",
    "setup/test_write.py",
    "cli/test_encode.py",
    "setup/test_reasons.py",
    "setup/test_sure.py",
    "cli/test_encode_blanks.py",
    "cli/test_worked.py",
    "fuzz/test_loaders.py",
    "frames/test_guard.py",
    "truth/test_pack.py",
    "service/test_signals.py",
    "cli/test_main.py",
    "workbench/test_stretch.py",
    "observe/test_innovation_check.py",
    "workbench/test_kept_uploads.py",
    "setup/test_find_temperatures.py",
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
