"""Fields of a point of the balances."""

FIELDS = ("I", "I2", "I_abs", "T_in", "flow", "soc", "V", "IV", "hours")
