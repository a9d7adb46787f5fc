"""The heat balances at a set of instants, which the effects of the catalogue may change.

A `Point` contains the quantities of a string's balances: inputs, temperatures, coefficients and heats. `Physics.rates`
fills it from states and inputs, lets every effect change its part, and closes the balances. All arrays share their
leading axes (the intervals of a record, or none live); the last axis counts the cells, or is 1 for quantities common to
the cells.

Lin et al., Eq 16-18, corrected as in `thermal.string`.
"""

from dataclasses import dataclass, field

from bms_gateway.thermal.parameters import Floats


@dataclass(slots=True)
class Point:
    """Inputs, temperatures, coefficients and heats; effects replace its arrays and never change them in place.

    Attributes
    ----------
    cells : int
    I, I2, I_abs : ndarray (…, 1)
        Mean current [A, discharge positive], mean square [A²] and mean magnitude [A] over the interval.
    T_in : ndarray (…, 1), °C
        Coolant inlet.
    flow : ndarray (…, 1)
        Coolant flow over nominal flow.
    soc, V, IV, hours : ndarray (…, 1)
        State of charge 0…1, mean cell voltage [V], mean of their product with the current [W], hours since the start.
    T_c, T_s : ndarray (…, n), °C
    R_e, R_c, R_u, C_c, C_s : ndarray, broadcastable to (…, n)
        Ω, K/W, K/W, J/K, J/K.
    C_f : ndarray, broadcastable to (…, n), W/K
        Heat-capacity flow of the stream that leaves cell k; infinite if it does not warm up.
    film_exponent : float
        Film flux grows as |T_s − T_f|^(1 + film_exponent).
    core, surface : ndarray (…, n), W
        Heat made in the core; heat at the surface from sources other than core, film and neighbours.
    T_f, film, inner : ndarray (…, n)
        Coolant at the cell [°C], flux surface to coolant [W], flux core to surface [W].
    y : ndarray (…, n), °C
        Reading of a thermocouple on the cell.
    memory : dict
        An effect's memory of the inputs, by the key of the effect: ndarray (…, k).
    extra, extra_rates : dict
        An effect's own states and their rates [1/s], by the key of the effect: ndarray (…, n, k).
    key : str
        Key of the effect whose hook runs.
    """

    cells: int
    I: Floats  # noqa: E741 - the field's symbol
    I2: Floats
    I_abs: Floats
    T_in: Floats
    flow: Floats
    soc: Floats
    V: Floats
    IV: Floats
    hours: Floats
    T_c: Floats
    T_s: Floats
    R_e: Floats
    R_c: Floats
    R_u: Floats
    C_c: Floats
    C_s: Floats
    C_f: Floats
    core: Floats
    surface: Floats
    T_f: Floats
    film: Floats
    inner: Floats
    y: Floats
    film_exponent: float = 0.0
    memory: dict[str, Floats] = field(default_factory=dict)
    extra: dict[str, Floats] = field(default_factory=dict)
    extra_rates: dict[str, Floats] = field(default_factory=dict)
    key: str = ""
