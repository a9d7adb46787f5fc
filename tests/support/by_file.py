"""How the tests are shared out to several workers."""

from functools import cache
from pathlib import Path

from xdist.scheduler import LoadScopeScheduling
from xdist.workermanage import WorkerController

LONGEST = (
    # half a minute and more, with the slow tests
    "acceptance/test_effects_live.py",
    "diagnosis/test_measured_records.py",
    "workbench/test_page.py",
    "engine/test_statistics.py",
    "chaos/test_scenarios.py",
    "cli/test_one_step.py",
    "diagnosis/test_long_string.py",
    "report/test_report_size.py",
    "workbench/test_robust.py",
    "acceptance/test_pack.py",
    "diagnosis/test_hidden_effects.py",
    "workbench/test_long_names.py",
    "diagnosis/test_measured_cells.py",
    "workbench/test_layout.py",
    "workbench/test_open_anything.py",
    "diagnosis/test_numbers.py",
    "workbench/test_measured_cell.py",
    "reproduce/test_whole.py",
    "health/test_heat_or_drift.py",
    "diagnosis/test_below_least.py",
    "cli/test_road_measured.py",
    "workbench/test_measure.py",
    "diagnosis/test_exchange.py",
    "workbench/test_every_view.py",
    "workbench/test_session.py",
    "workbench/test_kept_uploads.py",
    "fleet/test_atlas.py",
    "identify/test_window.py",
    "acceptance/test_late_coolant.py",
    "workbench/test_clicks.py",
    "workbench/test_at_rest.py",
    "workbench/test_doubt.py",
    "workbench/test_mailed_session.py",
    "benchmarks/test_flat_memory.py",
    "workbench/test_report_steps.py",
    # longest without them
    "workbench/test_desk.py",
    "health/test_heat.py",
    "setup/test_init.py",
    "diagnosis/test_compare.py",
    "setup/test_write.py",
    "observe/test_reversible.py",
    "diagnosis/test_record_windows.py",
    "identify/test_doubt.py",
    "cli/test_one_core.py",
    "cli/test_road.py",
    "service/test_signals.py",
    "service/test_fit_process.py",
    "engine/test_engine.py",
    "observe/test_effects.py",
    "frames/test_guard_rules.py",
    "store/test_recent.py",
    "observe/test_innovation_check.py",
    "report/test_html.py",
    "setup/test_sure.py",
    "cli/test_worked.py",
    "store/test_trial.py",
    "setup/test_reasons.py",
    "setup/test_find_temperatures.py",
    "engine/test_parked.py",
    "sensors/test_placement.py",
    "thermal/test_trajectory.py",
    "chaos/test_command.py",
    "workbench/test_stretch.py",
    "frames/test_noise_at_rest.py",
    "config/test_hostile.py",
    "setup/test_bad_input.py",
    "observe/test_adaptive.py",
    "setup/test_asking.py",
    "library/test_same_numbers.py",
    "truth/test_pack.py",
    "setup/test_bit_cuts.py",
    "identify/test_resistance_by_cell.py",
    "frames/test_neighbours.py",
    "bus/test_candump.py",
    "fleet/test_whole_fleet.py",
    "fuzz/test_loaders.py",
    "cli/test_export.py",
    "cli/test_baseline.py",
    "config/test_dbc_tables.py",
    "workbench/test_whiteness.py",
    "service/test_live.py",
    "workbench/test_doors.py",
    "frames/test_packed.py",
    "engine/test_told.py",
    "setup/test_clocks.py",
    "reproduce/test_rows.py",
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
