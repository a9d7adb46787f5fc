"""Causes other than ageing that change the R_e of a window: cooling, thermocouples, current sensor.

Each cause has its own flag, with a sentence that says what to do.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import exp, inf, nan, sqrt
from typing import Any

import numpy as np

from bms_gateway.errors import StateError, signed
from bms_gateway.health.ageing import stored_level
from bms_gateway.health.flag import Flag, Thresholds
from bms_gateway.health.limit_words import BAND_SD
from bms_gateway.health.trend import CONFIRM, J, Kind, Trend, U
from bms_gateway.thermal import Floats

COOLING = Thresholds(rise=(0.25, 0.50), fall=(0.15, 0.35), hold=2)
"""Growth of R_u: a clogged filter adds 20 to 40 %, a stopped fan doubles it."""
DRIFT = Thresholds(rise=(1.0, 2.0), fall=(0.6, 1.4), hold=2)
"""K since commissioning. A thermocouple of class 1 may be wrong by 1.5 K, but this error drifts by tenths of a K."""
CURRENT = Thresholds(rise=(1.0, 2.0), fall=(0.5, 1.5), hold=1)
"""Levels of suspicion against the current sensor; `CurrentWatch` computes them."""
SIGNIFICANT = 3.0  # a change of fewer sd than this raises no flag
ALIKE = 0.6
"""Smallest over largest drift. Above this ratio all thermocouples drift alike, and the inlet's sensor is the cause."""
INLET, INLET_SURE = 0.3, 4.0
"""K, and sd, of a drift that is common to all thermocouples. This limit may be lower than that of one thermocouple,
because two thermocouples do not drift alike by chance. An offset of the inlet's sensor shifts all cells at every load;
a change of R_e, R_u or flow shifts them only under load."""
PASSED, BACK = 0.5, 0.25
"""Shares of the latest windows that need one thermocouple left out, or that nothing explains: the report begins above
the first share and ends below the second."""
NEWEST = 0.2
"""Weight of the newest window in this share. The report begins after four windows. It ends eight windows after a
thermocouple was repaired."""
TOLD = 1.5  # value that raises `DRIFT` to its first level while this report lasts
JUMPED = 0.06  # ln: least size of a jump of R_e
OFF_VOLTAGE = Thresholds(rise=(0.05,), fall=(0.03,), hold=CONFIRM)
"""Change of ln(thermal over electrical resistance) since commissioning at which the current's scale is called wrong."""
WITNESS_SD = 0.012  # ln: the ratio at commissioning is known when the sd of its mean is below this
RATIO_FLOOR, RATIO_WALK = 0.04, 0.005  # ln: error of a window's ratio beyond its own sd; random step per window
RAIL = (0.03, 20)  # share and number of ticks at exactly the greatest current, above which the sensor is at its limit


@dataclass(slots=True)
class Cooling:
    """Thermal resistance to the coolant, against commissioning."""

    flag: Flag = field(default_factory=lambda: Flag(COOLING))
    growth: float = nan
    growth_sd: float = nan

    def update(self, trend: Trend) -> bool:
        """Look at the trend; whether the level changed."""
        mean, sd = trend.of(U)
        self.growth, self.growth_sd = exp(mean) - 1.0, exp(mean) * sd
        return self.flag.update(self.growth if mean > SIGNIFICANT * sd or mean <= 0.0 else 0.0)

    def restore(self, trend: Trend, level: object) -> None:
        """Take up a stored level beside the stored trend."""
        self.update(trend)
        self.flag = Flag(COOLING, stored_level(level, 2))

    def sentence(self, flow_known: bool) -> str:
        """Say what the flag means and what to do."""
        if not self.flag.level:
            return "cooling is as at commissioning again"
        why = "" if flow_known else " (the bus does not tell the coolant's flow: less of it looks the same)"
        grown = f"{signed(100 * self.growth, 0)} ± {100 * BAND_SD * self.growth_sd:.0f} %"
        return (
            f"heat leaves the cells less well than at commissioning (R_u {grown}){why}: "
            "check fan or pump, filter and ducts; this is no ageing of the cells"
        )


@dataclass(slots=True)
class Drift:
    """Offsets of the thermocouples against the inlet's sensor since commissioning, and thermocouples that came loose.

    Attributes
    ----------
    cells : tuple of int
        1-based cells with a thermocouple.
    kelvin, sd : ndarray (m,)
    loose : ndarray (m,)
        Share of the latest windows that agree with the trend only if this thermocouple is left out.
    strange : float
        Share of the latest windows that nothing explains.
    """

    cells: tuple[int, ...]
    flag: Flag = field(default_factory=lambda: Flag(DRIFT))
    kelvin: Floats = field(default_factory=lambda: np.empty(0))
    sd: Floats = field(default_factory=lambda: np.empty(0))
    common: float = 0.0
    loose: Floats = field(init=False)
    strange: float = 0.0
    _told: int | None = None

    def __post_init__(self) -> None:
        self.loose = np.zeros(len(self.cells))

    def took(self, kind: Kind, left_out: int | None) -> None:
        """Take the explanation that the trend has found for a window."""
        self.loose += NEWEST * ((np.arange(len(self.cells)) == left_out) - self.loose)
        self.strange += NEWEST * ((kind is Kind.STRANGE) - self.strange)
        shares = np.append(self.loose, self.strange + self.loose.sum())
        if self._told is not None and shares[self._told] < BACK:
            self._told = None
        if self.loose.max() >= PASSED:
            self._told = int(self.loose.argmax())
        elif self._told is None and shares[-1] >= PASSED:
            self._told = len(self.cells)

    def update(self, trend: Trend) -> bool:
        """Look at the trend; whether the level changed."""
        self.kelvin = trend.x[trend.drifts].copy()
        P = trend.P[trend.drifts, trend.drifts]
        self.sd = np.sqrt(np.diag(P))
        sure = np.abs(self.kelvin) > SIGNIFICANT * self.sd
        worst = float(np.abs(self.kelvin[sure]).max(initial=0.0))
        self.common = float(self.kelvin.mean()) if self._alike else 0.0
        if abs(self.common) > INLET_SURE * float(np.sqrt(P.mean())):
            worst = max(worst, min(abs(self.common) / INLET, TOLD))
        return self.flag.update(worst if self._told is None else max(worst, TOLD))

    @property
    def _alike(self) -> bool:
        size = np.abs(self.kelvin)
        return len(size) > 1 and size.min() > ALIKE * size.max() and len(set(np.sign(self.kelvin).tolist())) == 1

    def contact(self) -> dict[str, Any]:
        """State that neither the trend nor the level contains, as plain values."""
        return {"loose": self.loose.tolist(), "strange": self.strange, "told": self._told}

    def restore(self, trend: Trend, level: object, contact: Mapping[str, Any] | None) -> None:
        """Take up a stored level beside the stored trend; states of earlier versions have no `contact`."""
        if contact is not None:
            self.loose, self.strange = np.array(contact["loose"], dtype=np.float64), float(contact["strange"])
            self._told = None if contact["told"] is None else stored_level(contact["told"], len(self.cells))
            if self.loose.shape != (len(self.cells),) or not np.isfinite([*self.loose, self.strange]).all():
                raise StateError("health: the stored state is damaged or of another string; starting anew")
        self.update(trend)
        self.flag = Flag(DRIFT, stored_level(level, 2))

    @property
    def worst(self) -> int:
        """Cell whose thermocouple is most likely wrong; 0: the inlet's sensor, no single thermocouple, or none."""
        if not self.flag.level:
            return 0
        if self._told is not None:
            return self.cells[self._told] if self._told < len(self.cells) else 0
        return 0 if self._alike else self.cells[int(np.abs(self.kelvin).argmax())]

    def sentence(self) -> str:
        """Say what the flag means and what to do."""
        if not self.flag.level:
            return "thermocouples agree with the inlet's as at commissioning again"
        k = self.worst
        if self._told is not None:
            return self._passed_over(k)
        if k == 0:
            moved = float(np.mean(self.kelvin))
            return (
                f"all thermocouples read {signed(moved)} K against the coolant inlet's since commissioning: "
                "check the inlet's sensor first; this is no ageing of the cells"
            )
        moved = float(self.kelvin[self.cells.index(k)])
        other = "" if len(self.cells) > 1 else " or the inlet's sensor"
        return (
            f"the thermocouple of cell {k}{other} has drifted by {signed(moved)} K since commissioning: "
            "check its seat, or replace it; this is no ageing of the cells"
        )

    def _passed_over(self, k: int) -> str:
        if k:
            return (
                f"the thermocouple of cell {k} no longer follows its cell: drives fit all that is known only without "
                "it, so most likely it has come loose; it is left out of the growth of R_e until then: fasten or "
                "replace it; this is no ageing of the cells"
            )
        who = f"the thermocouple of cell {self.cells[0]}" if len(self.cells) == 1 else "a thermocouple"
        return (
            "most drives lately contradict what is known of the string, and neither R_e, cooling nor one offset "
            f"explains them: growth of R_e is held; most likely {who} or the inlet's sensor does not touch what it "
            "measures: check their seats, then the current sensor; if they are sound, bms-gateway export --last 2h "
            "--out recent.csv and bms-gateway diagnose recent.csv"
        )


@dataclass(slots=True)
class CurrentWatch:
    """Judges the current sensor by the heat, and by the voltage where the bus carries it.

    With a current that reads g times the true one, the heat gives R/g² and the voltage gives R/g. Ageing changes both
    by the same factor and leaves their ratio as it is; a wrong g changes the ratio.
    """

    flag: Flag = field(default_factory=lambda: Flag(CURRENT))
    ratio: float = nan
    _base: float = 0.0
    _base_var: float = inf
    _var: float = 0.0
    _off: Flag = field(default_factory=lambda: Flag(OFF_VOLTAGE))
    _newest: float = 0.0
    _jump: float = 0.0
    _shape: str = ""
    _shaped: int = 0

    @property
    def heard(self) -> bool:
        """Whether the ratio at commissioning is known, so that the voltage can show a wrong current."""
        return self._base_var <= WITNESS_SD**2

    @property
    def scale(self) -> float:
        """Change of ln(thermal over electrical resistance) since commissioning; 0 while it is not known."""
        return self.ratio - self._base if self.heard else 0.0

    @property
    def wrong_scale(self) -> bool:
        """Whether the voltage says that the current's scale is wrong."""
        return self._off.level > 0

    @property
    def believed(self) -> bool:
        """Whether the newest window's R_e may be used: it is left out as soon as a wrong scale is suspected."""
        return not self.wrong_scale and self._newest <= 1.0

    def listen(self, ln_ratio: float, sd: float) -> None:
        """Take ln(thermal over electrical resistance) of one window, and its sd; NaN where there was no voltage."""
        self._newest = 0.0
        if ln_ratio != ln_ratio:
            return
        R = sd**2 + RATIO_FLOOR**2
        if not self.heard:
            gain = 1.0 if self._base_var == inf else self._base_var / (self._base_var + R)
            self._base += gain * (ln_ratio - self._base)
            self._base_var = gain * R
            self.ratio, self._var = self._base, 0.0
            return
        self._newest = abs(ln_ratio - self._base) / (SIGNIFICANT * sqrt(R + self._base_var))
        P = self._var + RATIO_WALK**2
        gain = P / (P + R)
        self.ratio, self._var = self.ratio + gain * (ln_ratio - self.ratio), gain * R
        sure = abs(self.scale) > SIGNIFICANT * sqrt(self._var + self._base_var)
        self._off.update(abs(self.scale) if sure else 0.0)

    def doubted(self, shape: str) -> bool:
        """Take the suspicious `shape` of a window's current that contradicts the heat; empty: nothing is suspicious."""
        self._shaped = min(self._shaped + 1, 2 * CONFIRM) if shape else max(self._shaped - 1, 0)
        self._shape = shape or self._shape
        return bool(shape)

    def update(self, trend: Trend) -> bool:
        """Look at the trend; whether the level changed."""
        self._jump, sd = trend.of(J)
        jumped = abs(self._jump) > max(JUMPED, SIGNIFICANT * sd)
        certain = self.wrong_scale or self._shaped >= CONFIRM
        return self.flag.update(2.0 if certain else 1.0 if jumped and not self.heard else 0.0)

    def sentence(self) -> str:
        """Say what the flag means and what to do."""
        if not self.flag.level:
            return "the current agrees with the heat again"
        if self._shaped:
            return f"the current sensor {self._shape} and the heat contradicts it: check its range, wiring and supply"
        if self.wrong_scale:
            return (
                f"the current sensor reads about {signed(100 * (exp(-self.scale) - 1), 0)} % off: heat and voltage "
                "contradict it; check its scale; growth of R_e is held until then"
            )
        return (
            f"R_e has moved by {signed(100 * (exp(self._jump) - 1), 0)} % within a few drives, which no ageing does: "
            "either the current sensor's scale is wrong or a joint has come loose; no voltage is heard that could "
            "tell: compare the current with a clamp, then check joints and busbars"
        )

    def snapshot(self) -> dict[str, Any]:
        """State as plain values."""
        return {
            "level": self.flag.level,
            "ratio": self.ratio if self.heard else self._base,
            "base": self._base,
            "base_var": self._base_var if self._base_var < inf else None,
            "var": self._var,
            "off": self._off.level,
            "jump": self._jump,
            "shape": self._shape,
            "shaped": self._shaped,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take up a stored state."""
        self.flag = Flag(CURRENT, stored_level(state["level"], 2))
        self.ratio, self._base, self._jump = (float(state[key]) for key in ("ratio", "base", "jump"))
        self._base_var = inf if state["base_var"] is None else float(state["base_var"])
        self._var, self._shaped = float(state["var"]), int(state["shaped"])
        self._off = Flag(OFF_VOLTAGE, stored_level(state["off"], 1))
        self._shape = str(state["shape"])


def current_shape(current: Floats) -> str:
    """Describe what is suspicious in the mean currents of the ticks (K,), A, as the end of a sentence; may be empty."""
    size = np.abs(current[np.isfinite(current)])
    if not len(size):
        return ""
    most = float(size.max())
    if most > 0.0 and float(np.ptp(current[np.isfinite(current)])) < 1e-6 * most:
        return f"stands at {current[np.isfinite(current)][0]:.1f} A"
    rail = int((size > (1.0 - 1e-6) * most).sum())
    if most > 0.0 and rail > max(RAIL[1], RAIL[0] * len(size)):
        return f"never reads beyond {most:.1f} A, which it reads {100 * rail / len(size):.0f} % of the time,"
    return ""
