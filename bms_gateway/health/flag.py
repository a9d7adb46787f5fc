"""A flag with hysteresis: thresholds to rise, lower thresholds to fall, and a hold time for both."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Levels of a flag.

    Attributes
    ----------
    rise : tuple of float
        Ascending; at or above `rise[i]` the level is i + 1.
    fall : tuple of float
        Below `fall[i]`, which is less than `rise[i]`, the level falls from i + 1 to i.
    hold : int
        Number of observations in a row that must agree before the level changes.
    """

    rise: tuple[float, ...]
    fall: tuple[float, ...]
    hold: int


@dataclass(slots=True)
class Flag:
    """Level of one flag, 0 (nothing) upwards; only `update` changes it."""

    thresholds: Thresholds
    level: int = 0
    _wanted: int = 0
    _count: int = 0

    @property
    def stirred(self) -> bool:
        """Whether the flag is raised, or has begun to count observations towards another level."""
        return self.level > 0 or self._count > 0

    def update(self, value: float) -> bool:
        """Take one observation.

        Parameters
        ----------
        value : float
            What the thresholds speak of; NaN says nothing and changes nothing.

        Returns
        -------
        bool
            Whether the level changed.

        Examples
        --------
        >>> f = Flag(Thresholds((0.10, 0.20), (0.07, 0.16), hold=2))
        >>> [f.update(x) for x in (0.12, 0.12, 0.08, 0.08, 0.05, 0.05)], f.level
        ([False, True, False, False, False, True], 0)
        """
        if value != value:
            return False
        if not self.level and value < self.thresholds.rise[0]:  # nothing to tell, as nearly always
            self._count = 0
            return False
        wanted = sum(value >= r for r in self.thresholds.rise)
        if wanted < self.level:
            wanted = max(wanted, sum(value >= f for f in self.thresholds.fall[: self.level]))
        if wanted == self.level:
            self._count = 0
            return False
        self._count = self._count + 1 if wanted == self._wanted else 1
        self._wanted = wanted
        if self._count < self.thresholds.hold:
            return False
        self.level, self._count = wanted, 0
        return True
