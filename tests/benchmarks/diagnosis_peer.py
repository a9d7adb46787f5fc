"""The prototype of the diagnosis on the same logs, in a long-lived process of its own Python.

As a script (`peer-python diagnosis_peer.py FOLDER`) it imports `diag2` from that folder and answers each line of JSON
{csv, cells, out} with one of its verdict; the cores that it believes in go to the file `out`. It sees a table, never
the truth. `Peer` is the other end.
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

CALLED = {
    "entropic": "entropic_heat",
    "re_temp": "resistance_temperature",
    "re_soc": "resistance_soc",
    "re_asym": "resistance_asymmetry",
    "polarisation": "polarization",
    "flow_ru": "flow_dependent_cooling",
    "natconv": "natural_convection",
    "busbar_end": "busbar_joule",
    "tc_lag": "thermocouple_lag",
    "i_offset": "current_offset",
    "radial": "radial_gradient",
    "tc_offset": "thermocouple_offset",
    "tc_contact": "thermocouple_contact",
    "const_heat": "neighbour_heat",
    "re_cell": "cell_resistance",
    "ru_cell": "cell_cooling",
    "rc_cell": "cell_conduction",
    "bypass": "coolant_bypass",
    "re_drift": "resistance_drift",
    "ru_drift": "cooling_drift",
    "pcm": "phase_change",
}
"""Ids of the catalogue by the prototype's family names, where they differ."""
VERDICTS = {
    "nothing missing": ("adequate", False),
    "found": ("missing_effect", False),
    "found, but something unknown remains": ("missing_effect", True),
    "unknown effect": ("unknown_effect", True),
}


class Peer:
    """Client of one process that runs the prototype."""

    def __init__(self, folder, python):
        self._files = tempfile.TemporaryDirectory()
        self._process = subprocess.Popen(
            [python, __file__, str(folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def close(self):
        self._process.stdin.close()
        self._process.wait()
        self._files.cleanup()

    def run(self, log):
        """Verdict in the form of `diagnosis_case`."""
        import numpy as np

        s = log.scenario
        table, cores = (Path(self._files.name) / name for name in ("log.csv", "cores.npz"))
        write_table(log, table)
        order = {"csv": str(table), "cells": s.cells, "out": str(cores)}
        print(json.dumps(order), file=self._process.stdin, flush=True)
        said = json.loads(self._process.stdout.readline())
        verdict, remains = VERDICTS[said["verdict"]]
        believed = np.load(cores)
        named = [
            {
                "effect": CALLED.get(e["name"], e["name"]),
                "cell": int(e["variant"].split()[-1]) if e["variant"].startswith(("cell", "after")) else None,
                "tied": [CALLED.get(g, g) for g in e["group"] if g != e["name"]],
                "odds": None,
            }
            for e in said["effects"]
        ]
        if verdict == "unknown_effect":
            named = []
        core = [float(np.sqrt(np.mean((believed[k] - log.core) ** 2))) for k in ("before", "after")]
        return {
            "verdict": verdict,
            "remains": remains,
            "named": named,
            "structure": [said["struct_before"], said["struct_after"]],
            "held": [said["rmse_test"][0], said["rmse_test"][-1]],
            "core": [core[0], core[1] if named else core[0]],
            "seconds": said["runtime"],
        }


def write_table(log, path):
    """A log with the prototype's columns. It knows no blanks but in the surfaces: the others are bridged for it."""
    import csv

    import numpy as np

    from tests.truth.pack import NOMINAL_FLOW

    t = log.table
    columns = {"time_s": t["time_s"], "current_A": t["current_A"], "T_inlet_C": t["coolant_inlet_C"]}
    columns |= {f"T_s_{k}_C": t[f"surface_{k}_C"] for k in log.scenario.sensors}
    for ours, its in (("soc", "soc"), ("voltage_V", "voltage_V"), ("coolant_flow_m3_s", "coolant_flow_m3s")):
        if ours in t:
            # its nominal flow is 0.0094 m³/s
            columns[its] = t[ours] * 0.0094 / NOMINAL_FLOW if ours == "coolant_flow_m3_s" else t[ours]
    rows = np.arange(len(t["time_s"]))
    for name, x in columns.items():
        if not name.startswith("T_s_"):
            known = np.isfinite(x)
            columns[name] = np.interp(rows, rows[known], x[known])
    with open(path, "w", newline="", encoding="utf-8") as f:
        out = csv.writer(f)
        out.writerow(columns)
        out.writerows(zip(*([("" if x != x else f"{x:.7g}") for x in c] for c in columns.values()), strict=True))


def serve(folder):
    """Run in the prototype's Python."""
    sys.path.insert(0, folder)
    answers, sys.stdout = sys.stdout, sys.stderr
    import diag2
    import numpy as np

    for line in sys.stdin:
        order = json.loads(line)
        data = diag2.prepare(diag2.load_csv(order["csv"], order["cells"]), q_ah=8.0)
        begin = time.process_time()
        said, before, after = diag2.diagnose(data)
        said["runtime"] = time.process_time() - begin
        cores = [diag2.simulate(data, fit.pars, fit.th)[1] for fit in (before, after)]
        np.savez(order["out"], before=cores[0], after=cores[1])
        keep = ("verdict", "struct_before", "struct_after", "rmse_test", "runtime")
        effects = [{k: e[k] for k in ("name", "variant", "group")} for e in said["effects"]]
        print(json.dumps({k: said[k] for k in keep} | {"effects": effects}), file=answers, flush=True)


if __name__ == "__main__":
    serve(sys.argv[1])
