"""Time of a diagnosis of all effects, 12 cells x 1 h at 1 Hz: `python -m tests.benchmarks.bench_diagnosis_time`.

Three logs of the same pack: nothing hidden, an effect that is named, and a strong one that bends everything first.
`[--json FILE]`. CPU time of each of seven alternating rounds.
"""

import argparse
import json
import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile

from tests.benchmarks.rounds import alternate

HIDDEN = {
    "nothing hidden": {},
    "entropic_heat, medium": {"entropic_heat": ("medium", None)},
    "resistance_temperature, strong": {"resistance_temperature": ("strong", None)},
}


def main() -> None:
    """Print the times."""
    from bms_gateway.config.model_file import parse_model
    from bms_gateway.diagnosis.diagnosis import diagnose
    from bms_gateway.records.read import read_measurements
    from tests.truth.hidden import Scenario, make_logs

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    sensors = tuple(range(1, 13))
    logs = make_logs([Scenario(e, cells=12, sensors=sensors, seconds=3600, seed=5) for e in HIDDEN.values()])
    runs, verdicts = {}, {}
    with tempfile.TemporaryDirectory() as folder:
        for name, log in zip(HIDDEN, logs, strict=True):
            log.write_csv(Path(folder) / "log.csv")
            model = parse_model(log.model)
            records = read_measurements([Path(folder) / "log.csv"], model=model)

            def run(name=name, model=model, records=records):
                verdicts[name] = diagnose(model.unfitted, records).verdict

            runs[name] = run
        times = alternate(runs)
    for name, t in times.items():
        spread = f"{min(t.seconds):.2f} to {max(t.seconds):.2f}"
        print(f"{name}: {t.median:.2f} s CPU ({spread}), verdict {verdicts[name]}")
    if args.json:
        args.json.write_text(
            json.dumps({name: {"cpu_s": t.seconds, "verdict": verdicts[name]} for name, t in times.items()})
        )


if __name__ == "__main__":
    main()
