"""Does the model still explain the surfaces? The size of the innovations against what the observer expects of them."""

from dataclasses import dataclass, field
from math import isfinite, nan

from bms_gateway.health.flag import Flag, Thresholds
from bms_gateway.thermal import Floats

GRACE_S = 120.0
"""After a start or a pause the observer finds the state first: what it is surprised by then says nothing."""
WINDOW_S = 600.0  # ten minutes: longer than a burst of noise, shorter than a drive
# Mean square of innovations in units of their own variance: 1 when all is well. Model error is slow, so it stays close
# to 1 for long; 4 means that the surfaces are off by twice the band, minute after minute: suspected; 9 confirmed.
EXCESS = Thresholds(rise=(4.0, 9.0), fall=(2.0, 6.0), hold=60)


@dataclass(slots=True)
class Mismatch:
    """Model mismatch of one string.

    Attributes
    ----------
    flag : Flag
    excess : float
        Sliding mean of the squared normalised innovation; NaN before the first reading.
    """

    flag: Flag = field(default_factory=lambda: Flag(EXCESS))
    excess: float = nan
    _grace: float = GRACE_S

    def update(self, normalised: Floats, dt: float) -> bool:
        """Take one tick's innovations.

        Parameters
        ----------
        normalised : ndarray
            Innovations over their standard deviations; NaN where there was no reading.
        dt : float
            Seconds since the last tick.

        Returns
        -------
        bool
            Whether the flag's level changed.
        """
        # a string has a few sensors: plain numbers are faster than arrays
        squares = [value * value for value in normalised.tolist() if isfinite(value)]
        return self.take(sum(squares) / len(squares) if squares else nan, dt)

    def take(self, now: float, dt: float) -> bool:
        """Take the mean square of one tick's normalised innovations, NaN where there was no reading; see `update`."""
        if self._grace > 0.0:
            self._grace -= dt
            return False
        if now != now:
            return False
        if self.excess != self.excess:
            self.excess = now
        self.excess += (now - self.excess) * min(1.0, dt / WINDOW_S)
        return self.flag.update(self.excess)

    def resume(self) -> None:
        """Begin anew after a pause; a raised flag stays until the readings speak against it."""
        self._grace, self.excess = GRACE_S, nan

    def sentence(self) -> str:
        """Say what the flag means and what to do."""
        if self.flag.level:
            return (
                f"the model does not explain the surfaces (innovations {self.excess**0.5:.1f} times their band over "
                "ten minutes): a physical effect is missing or a sensor errs; bms-gateway export --last 2h --out "
                "recent.csv, then bms-gateway diagnose recent.csv --model the string's model file"
            )
        return "the model explains the surfaces again"
