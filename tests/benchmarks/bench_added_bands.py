"""Bands of cores before and after an addition that leaves them unproven, against the true cores.

`python -m tests.benchmarks.bench_added_bands [--only far|losses] [--first BASE] [--limit N]`

`far`: single cells with a hidden effect, described by a file whose resistances are off by 0.2 to 8 times at an sd of
40 %. `losses`: packs of 1, 5 and 12 cells that lose heat through tabs or to the surroundings. Each is diagnosed, and
what is named is added, from the losses also the other one. The truth is no code of the package.
"""

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from bms_gateway.diagnosis.adding import add_effects, asked_for
from bms_gateway.diagnosis.core_band import BAND_SD
from bms_gateway.diagnosis.core_known import KnownCore
from bms_gateway.diagnosis.diagnosis import diagnose
from bms_gateway.thermal import StringModel
from tests.diagnosis.hidden_record import record_of
from tests.truth.hidden import HiddenLog, Scenario, make_log
from tests.truth.suites import one_cell

FAR, LOSSES = 771, 8_810_000
"""First seeds of the figures in the room's README; no rule was chosen on them."""
TIMES = {"R_e": (0.3, 1.0, 3.0, 8.0), "R_u": (0.2, 1.0, 4.0), "R_c": (0.7, 1.4)}
KNOWN = {"C_c": 0.1, "C_s": 0.1, "R_e": 0.4, "R_c": 0.5, "R_u": 0.4}
SENSORS = {1: (1,), 5: (1, 3, 5), 12: (1, 4, 7, 10, 12)}
LOST = (
    {"ambient_loss": "medium"},
    {"core_loss": "medium"},
    {"ambient_loss": "strong"},
    {"core_loss": "strong"},
    {"ambient_loss": "medium", "core_loss": "medium"},
    {"ambient_loss": "strong", "core_loss": "medium"},
    {"ambient_loss": "medium", "core_loss": "strong"},
    {"ambient_loss": "strong", "radial_gradient": "medium"},
    {"core_loss": "strong", "surface_joule": "medium"},
)


@dataclass(frozen=True)
class Outcome:
    """One addition: half width of the 95 % band of the core known least, and error (rms), K, and share inside."""

    name: str
    added: str
    half_K: tuple[float, float]
    error_K: tuple[float, float]
    inside: tuple[float, float]
    by_numbers: bool

    def line(self) -> str:
        """Write it."""
        (h0, h1), (e0, e1), (i0, i1) = self.half_K, self.error_K, self.inside
        rule = "; by the distance of its numbers alone" if self.by_numbers else ""
        return (
            f"{self.name}, + {self.added}: ± {h0:.1f} -> ± {h1:.1f} K, error {e0:.2f} -> {e1:.2f} K, "
            f"inside {100 * i0:.0f} -> {100 * i1:.0f} %{rule}"
        )


def far_files(base: int) -> Iterator[tuple[HiddenLog, StringModel, tuple[str, ...]]]:
    """Logs of single cells, and models whose numbers are far off."""
    for scenario in one_cell(base):
        if any(size == "weak" for size, _ in scenario.effects.values()):
            continue
        rng = np.random.default_rng([scenario.seed, 77])
        times = {k: float(rng.choice(some)) for k, some in TIMES.items()}
        if times["R_e"] == times["R_u"] == 1.0:
            times["R_u"] = 4.0
        log = make_log(scenario)
        _, model = record_of(log)
        priors = {k: replace(p, value=p.value * times.get(k, 1.0), rel_sd=KNOWN[k]) for k, p in model.priors.items()}
        yield log, replace(model, priors=priors), ()


def losses(base: int) -> Iterator[tuple[HiddenLog, StringModel, tuple[str, ...]]]:
    """Logs of packs that lose heat, their models, and the losses to add."""
    cases = [(cells, effects) for cells in SENSORS for effects in LOST]
    for k, (cells, effects) in enumerate(cases):
        log = make_log(
            Scenario(
                {name: (size, None) for name, size in effects.items()},
                cells=cells,
                sensors=SENSORS[cells],
                noise=(0.05, 0.1)[k % 2],
                cycle=("urban", "us06", "mixed")[k % 3],
                inlet=("steps", "sine")[k % 2],
                seed=base + k,
            )
        )
        yield log, record_of(log)[1], ("core_loss", "ambient_loss")


def outcomes(log: HiddenLog, model: StringModel, also: tuple[str, ...]) -> Iterator[Outcome]:
    """Diagnose, add what is named and what is asked for, and hold what is accepted without proof against the truth."""
    record, _ = record_of(log)
    d = diagnose(model, [record])
    wants = [tuple(s.candidate.key for s in d.selected)] if d.selected else []
    for keys in dict.fromkeys([*wants, *((key,) for key in also)]):
        found = add_effects(model, [record], asked_for(list(keys), model), ask=lambda *_a, **_k: d)
        before, after = found.core
        if found.refused or after.proven:
            continue
        judged = [_against(core, log) for core in (before, after)]
        half, error, inside = zip(*judged, strict=True)
        yield Outcome(log.scenario.name, " + ".join(keys), half, error, inside, after.for_its_numbers)


def _against(core: KnownCore, log: HiddenLog) -> tuple[float, float, float]:
    """Half width of the core known least, error of all cores, and the share inside of the cell with the least."""
    (band,) = core.bands
    seconds = np.arange(len(log.core))
    true = np.stack([np.interp(band.time_s, seconds, x) for x in log.core.T], axis=1)
    error = band.T_c - true
    inside = (np.abs(error) <= BAND_SD * band.total_K).mean(axis=0)
    return float(core.half_width_K.max()), float(np.sqrt(np.mean(error**2))), float(inside.min())


def main() -> None:
    """Print each addition and the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("far", "losses"))
    parser.add_argument("--first", type=int, help="first seed, or base of the suite")
    parser.add_argument("--limit", type=int, help="records of each kind")
    args = parser.parse_args()
    for kind, records, first in (("far", far_files, FAR), ("losses", losses, LOSSES)):
        if args.only not in (None, kind):
            continue
        found = []
        for case in islice(records(first if args.first is None else args.first), args.limit):
            for one in outcomes(*case):
                found.append(one)
                print(one.line(), flush=True)
        told = [x for x in found if x.by_numbers] if kind == "far" else found
        if told:
            half = np.array([x.half_K for x in told])
            (h0, h1), (H0, H1) = half.min(axis=0), half.max(axis=0)
            print(
                f"{kind}: {len(told)} of {len(found)} unproven additions"
                f"{' by the distance of their numbers alone' if kind == 'far' else ''}: ± {h0:.1f} to {H0:.1f} -> "
                f"± {h1:.1f} to {H1:.1f} K, error at most {max(x.error_K[1] for x in told):.2f} K, "
                f"least share inside {100 * min(x.inside[1] for x in told):.0f} %"
            )


if __name__ == "__main__":
    main()
