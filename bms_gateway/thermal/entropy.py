"""Reversible heat of cells of vehicles before anything is known of it: heat -I T dU/dT, T the core's in kelvin."""

ENTROPIC_SD = 0.25e-3
"""V/K: sd of the entropic coefficient dU/dT, in the middle of the charge that is moved."""
ENTROPIC_SLOPE_SD = 1e-3
"""V/K per capacity: sd of its slope over the charge, half as much more or less at one end as in the middle."""
ENTROPIC = ("entropic", "entropic_slope")
"""The coefficient where its slope is stated from, and the slope, as numbers of a string; in mV/K, which makes them of
the same order as the logarithms of its other numbers."""
PER_MV = 1e-3
PRIOR_SD = ENTROPIC_SD / PER_MV, ENTROPIC_SLOPE_SD / PER_MV
"""Of `ENTROPIC`, mV/K."""
MOST = 20.0
"""mV/K: far above the coefficient of any electrode; a stored number beyond it is damaged."""
KELVIN = 273.15
CAPACITY_AH = 8.0
"""Capacity if the model has none: the slope over the charge needs only its order of magnitude."""
