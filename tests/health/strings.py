"""Strings for health tests: windows made up, fed as results of jobs."""

import numpy as np

from bms_gateway.health import HealthResult, StringHealth
from bms_gateway.thermal import AddedEffect, Prior, StringModel
from tests.health.observed import observed

NOMINAL = {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79, "R_cc": 4.0, "C_f": 11.33}
DAY_NS = 86_400_000_000_000


def model(R_e_sd: float = 0.3, *, fitted: bool = False, sensors=(1, 3), effects: tuple[AddedEffect, ...] = ()):
    priors = {k: Prior(v, 0.05) for k, v in NOMINAL.items()} | {"R_e": Prior(3.5e-3, R_e_sd)}
    return StringModel(3, sensors, "full", priors, "ntu", effects=effects, before=priors if fitted else None)


class Life:
    """A string and its drives, one a day."""

    def __init__(self, health: StringHealth | None = None, seed: int = 1) -> None:
        self.health = health or StringHealth(model(), known=True)
        self.rng = np.random.default_rng(seed)
        self.day, self.told = 0, []

    def drive(self, windows: int, *, shape: str = "", ratio: float = float("nan"), share: float = 1.0, **more) -> None:
        for _ in range(windows):
            seen = observed(self.rng, core=self.rng.uniform(10, 40), **more)
            if len(self.health.model.sensors) == 1:
                seen = observed(self.rng, core=self.rng.uniform(10, 40), **({"drift": (0.0,)} | more))
            result = HealthResult(seen, share, shape, ratio + self.rng.normal(0, 0.01))
            self.told += self.health.accept(result, self.day * DAY_NS)
            self.day += 1

    def codes(self) -> list[tuple[str, int]]:
        return [(c.code, c.level) for c in self.told]
