"""A pack's finer physics: the truth that writes logs with a hidden effect. Nothing of the package is used here.

Cell k of n along the coolant path, currents constant within each second, everything else by midpoint steps of half
a second at the most:

    C_c dT_c/dt = heat − (T_c − T_s)/R_c − core_G (T_c − T_sink)
    C_s dT_s/dt = (T_c − T_s)/R_c − film + conduction from the neighbours + heat at the casing − G (T_s − 25 °C)
    film        = (T_s − T_f)/R_u, or C_f (1 − exp(−1/(R_u C_f))) (T_s − T_f) where the stream warms along a cell
    T_f of the next cell = T_f + film/C_f

The core is one node, or a cylinder of concentric shells of equal thickness in which heat is made uniformly, with a
share of R_c spread over the shells and the rest at their edge; its temperature is then the mean over the volume.

A log is prepared as `Terms`: what enters the balances, second by second and cell by cell. The effects (`effects.py`
for those of the catalogue, `strange.py` for those that are in none) change these terms. `integrate` then takes many
logs of equal length and number of cells through ONE loop over time: the cost is the loop's, hardly the logs'.
"""

from dataclasses import dataclass, field

import numpy as np

KELVIN = 273.15
T_REF = 298.15
"""K: where R_e and I_0 are stated."""
GAS, FARADAY = 8.314462618, 96485.33212
NOMINAL = {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79, "R_cc": 4.0, "C_f": 11.33}
"""Lin et al., Table 1 (A123 32157); C_f of 9.5 L/s of air; J/K, J/K, Ω, K/W, K/W, K/W, W/K."""
NOMINAL_FLOW = 0.0095
CAPACITY_AH = 8.0
"""20C is 160 A."""
REACTION_LIMIT = 9.0
"""W: a self-heating reaction is as fast as its reactants diffuse; no pack runs away here."""


@dataclass
class Terms:
    """What enters the heat balances of one log. K seconds, n cells; lists per second are means over that second.

    I, I2, I2_charge, I_abs, soc, flow : (K,) A, A², A² (of the charging part), A, 1, ratio to nominal.
    inlet : (K + 1,) °C at the cells' entry, straight lines between instants. hours : (K,) since the start, mid-second.
    C_c, C_s, R_c : (n,). R_e, R_u, C_f : (K, n). R_cc : scalar.
    """

    I: np.ndarray  # noqa: E741 - the field's symbol
    I2: np.ndarray
    I2_charge: np.ndarray
    I_abs: np.ndarray
    soc: np.ndarray
    flow: np.ndarray
    inlet: np.ndarray
    C_c: np.ndarray
    C_s: np.ndarray
    R_c: np.ndarray
    R_e: np.ndarray
    R_u: np.ndarray
    C_f: np.ndarray
    R_cc: float
    rows: np.ndarray
    """(K,) A: the current held from each stamp of the log on; I where stamps do not jitter."""
    start: float
    """°C of core and casing at the start."""
    coolant: str = "bulk"
    rings: int = 1
    share: float = 0.0
    """Share of R_c spread over the shells, where there are shells."""
    asymmetry: float = 0.0
    B: float = 0.0
    """K; R_e falls as exp(B (1/T_c − 1/298.15 K))."""
    exchange_current: float = np.inf
    exchange_energy: float = 0.0
    film_power: float = 0.0
    latent: float = 0.0
    melting: float = 0.0
    melting_width: float = 1.0
    reaction: float = 0.0
    """W at 45 °C, e-fold every `reaction_K`."""
    reaction_K: float = 6.0
    fan: tuple = ()
    """(on above °C, off below °C, flow ratio when on), by the hottest casing: unrecorded."""
    water: tuple = ()
    """(J to evaporate per cell, W/K, °C of the dew point)."""
    entropic: np.ndarray | None = None
    """(K,) V/K."""
    core_heat: np.ndarray | None = None
    casing_heat: np.ndarray | None = None
    G: np.ndarray | None = None
    """(n,) W/K to surroundings at 25 °C."""
    core_G: np.ndarray | None = None
    """(n,) W/K from the core to `sink`."""
    sink: np.ndarray | None = None
    """(K,) °C."""
    drop: np.ndarray | None = None
    """(K,) V beside I R_e and the charge transfer."""
    hours: np.ndarray = field(default_factory=lambda: np.empty(0))

    def __post_init__(self):
        K, n = self.K, self.n
        self.hours = (np.arange(K) + 0.5) / 3600.0
        self.entropic, self.drop = np.zeros(K), np.zeros(K)
        self.core_heat, self.casing_heat, self.G = np.zeros((K, n)), np.zeros((K, n)), np.zeros(n)
        self.core_G, self.sink = np.zeros(n), np.zeros(K)

    @property
    def K(self):
        return len(self.I)

    @property
    def n(self):
        return len(self.C_c)

    @property
    def shape(self):
        """What logs of one loop share: (seconds, cells, shells, steps per second)."""
        # The shells' fastest rate is about 1.5/share per second; the midpoint rule is stable below 2 per step.
        return self.K, self.n, self.rings, 2 if self.rings == 1 else max(2, int(np.ceil(1.2 / self.share)))


def terms(cells, current, inlet, flow, soc_0, *, means=None, start=None, coolant="bulk", **values):
    """Terms of a pack without effects.

    values : C_c, C_s, R_e, R_c, R_u scalar or (n,), R_cc, C_f; nominal where not given.
    current : (K,) A held for a second each; `means` = (I, I², I² of charging, |I|) in its place for stamps that jitter.
    inlet : (K + 1,) °C. flow : (K,) ratio to nominal, C_f follows it.
    """
    v = NOMINAL | values
    if cells == 1:
        v |= {"C_f": np.inf}
    current = np.asarray(current, float)
    I, I2, I2_charge, I_abs = means or (  # noqa: E741
        current,
        current**2,
        np.minimum(current, 0) ** 2,
        np.abs(current),
    )
    K, flow = len(I), np.asarray(flow, float)

    def per_cell(x):
        return np.array(np.broadcast_to(x, (cells,)), float)

    moved = np.concatenate([[0.0], np.cumsum(I)]) / 3600 / CAPACITY_AH
    return Terms(
        I=I,
        I2=I2,
        I2_charge=I2_charge,
        I_abs=I_abs,
        soc=soc_0 - (moved[1:] + moved[:-1]) / 2,
        flow=flow,
        inlet=np.array(inlet, float),
        C_c=per_cell(v["C_c"]),
        C_s=per_cell(v["C_s"]),
        R_c=per_cell(v["R_c"]),
        R_e=np.tile(per_cell(v["R_e"]), (K, 1)),
        R_u=np.tile(per_cell(v["R_u"]), (K, 1)),
        C_f=np.tile(v["C_f"] * flow[:, None], (1, cells)),
        R_cc=v["R_cc"],
        rows=current,
        start=float(inlet[0]) if start is None else start,
        coolant=coolant,
    )


@dataclass(frozen=True)
class Trace:
    """Temperatures of one log at the instants 0…K, °C, and the mean overpotential at the current of each row, V."""

    core: np.ndarray
    surface: np.ndarray
    coolant: np.ndarray
    overpotential: np.ndarray


def shells(rings, share):
    """Volume shares and conductances of a cylinder whose mean-to-edge resistance is `share` and edge film 1 − share.

    Returns w (rings,), the conductances between shells (rings − 1,) and that from the last to the casing, times 1/R_c.
    """
    edge = np.arange(rings + 1) / rings
    w = np.diff(edge**2)
    middle = (edge[1:] + edge[:-1]) / 2
    # Uniform heat in a solid cylinder: mean-to-edge resistance 1/(8 π k L) = share, so 2 π k L = 1/(4 share).
    k = 1 / (4 * share)
    # Differences between middles give the flux of a parabola exactly: no error of the grid in the steady profile.
    inner = k * edge[1:-1] * rings
    outer = 1 / ((1 - middle[-1] ** 2) / (2 * k) + 1 - share)
    return w, inner, outer


def _share(x):
    """Share of the gap that a stream takes up which warms along the cell."""
    return -np.expm1(-1 / (x.R_u * x.C_f))


class _Batch:
    """Terms of many logs side by side: (K, n, B), (n, B) or (B,)."""

    def __init__(self, logs):
        first = logs[0]
        self.B_logs, self.n, self.K, self.rings = len(logs), first.n, first.K, first.rings

        def stack(of):
            return np.ascontiguousarray(np.stack([of(x) for x in logs], axis=-1))

        def some(of, neutral=0.0):
            got = stack(of)
            return got if np.any(got != neutral) else None

        self.inlet = stack(lambda x: x.inlet)
        self.start = stack(lambda x: x.start)
        self.joule = stack(lambda x: (x.I2 + x.asymmetry * x.I2_charge)[:, None] * x.R_e)
        self.G_u = stack(lambda x: 1 / x.R_u if x.coolant == "bulk" or x.n == 1 else x.C_f * _share(x))
        self.uptake = stack(lambda x: 1 / (x.R_u * x.C_f) if x.coolant == "bulk" else _share(x))
        self.C_c, self.C_s, self.G_c = stack(lambda x: x.C_c), stack(lambda x: x.C_s), stack(lambda x: 1 / x.R_c)
        self.G_cc = stack(lambda x: 1 / x.R_cc)
        self.B = some(lambda x: x.B)
        self.entropic = some(lambda x: -x.I * x.entropic)
        self.core_heat, self.casing_heat = some(lambda x: x.core_heat), some(lambda x: x.casing_heat)
        self.G, self.core_G = some(lambda x: x.G), some(lambda x: x.core_G)
        self.sink = stack(lambda x: x.sink)
        self.film_power = some(lambda x: x.film_power)
        # rms within the second: charge transfer is steep only near 0 A, where a second has one current
        self.amps = None
        if any(np.isfinite(x.exchange_current) for x in logs):
            self.amps = stack(lambda x: np.sqrt(x.I2) * np.isfinite(x.exchange_current))
            self.half = stack(lambda x: np.nan_to_num(0.5 / x.exchange_current))
            self.E = stack(lambda x: x.exchange_energy)
        self.latent = some(lambda x: x.latent)
        if self.latent is not None:
            self.melting, self.width = stack(lambda x: x.melting), stack(lambda x: x.melting_width)
        self.reaction = some(lambda x: x.reaction)
        self.reaction_K = stack(lambda x: x.reaction_K)
        self.fan = stack(lambda x: np.array(x.fan or (1e9, 1e9, 1.0))) if any(x.fan for x in logs) else None
        self.water = stack(lambda x: np.array(x.water or (0.0, 0.0, 0.0))) if any(x.water for x in logs) else None
        if self.rings > 1:
            parts = [shells(x.rings, x.share) for x in logs]
            self.w = np.stack([p[0] for p in parts], -1)[:, None, :]
            self.inner = np.stack([p[1] for p in parts], -1)[:, None, :] * self.G_c
            self.outer = np.stack([p[2] for p in parts], -1) * self.G_c
            self.shell_C = self.w * self.C_c

    def film(self, T_s, T_in, G_u, uptake):
        """Heat from the casings to the stream, W, and the stream at each cell, °C."""
        if self.B_logs == 1 and self.film_power is None:
            return self._film_of_one(T_s, T_in, G_u, uptake)
        flux, T_f = np.empty_like(T_s), np.empty_like(T_s)
        stream = T_in
        for c in range(self.n):
            T_f[c] = stream
            gap = T_s[c] - stream
            if self.film_power is not None:
                gap = gap * (np.abs(gap) / 5.0) ** self.film_power
            flux[c] = gap * G_u[c]
            stream = stream + gap * uptake[c]
        return flux, T_f

    @staticmethod
    def _film_of_one(T_s, T_in, G_u, uptake):
        """The same in numbers of Python, which are many times faster one by one."""
        flux, T_f, stream = [], [], float(T_in[0])
        for T, G, taken in zip(T_s[:, 0].tolist(), G_u[:, 0].tolist(), uptake[:, 0].tolist(), strict=True):
            T_f.append(stream)
            gap = T - stream
            flux.append(gap * G)
            stream += gap * taken
        return np.array(flux)[:, None], np.array(T_f)[:, None]

    def heat(self, k, T_c):
        """Heat made in the cores, less what leaves them by another way than their casings, W."""
        q = self.joule[k]
        absolute = T_c + KELVIN
        if self.B is not None:
            q = q * np.exp(self.B * (1 / absolute - 1 / T_REF))
        if self.amps is not None:
            slow = np.exp(self.E * (1 / absolute - 1 / T_REF))
            q = q + self.amps[k] * (2 * GAS / FARADAY) * absolute * np.arcsinh(self.amps[k] * self.half * slow)
        if self.entropic is not None:
            q = q + self.entropic[k] * absolute
        if self.core_heat is not None:
            q = q + self.core_heat[k]
        if self.reaction is not None:
            rising = self.reaction * np.exp(np.minimum((T_c - 45.0) / self.reaction_K, 30.0))
            q = q + rising / (1 + rising / REACTION_LIMIT)
        if self.core_G is not None:
            q = q - self.core_G * (T_c - self.sink[k])
        return q

    def rates(self, k, x, T_in, G_u, uptake, extra):
        """d/dt of x (rings + 1, n, B), the casing last; with the film's stream."""
        T_s = x[-1]
        rate = np.empty_like(x)
        if self.rings == 1:
            outward = (x[0] - T_s) * self.G_c
            rate[0] = (self.heat(k, x[0]) - outward) / self.C_c
        else:
            T = x[:-1]
            q = self.heat(k, self.mean(x))
            outward = (T[-1] - T_s) * self.outer
            between = (T[:-1] - T[1:]) * self.inner
            net = self.w * q
            net[:-1] -= between
            net[1:] += between
            net[-1] -= outward
            rate[:-1] = net / self.shell_C
        flux, T_f = self.film(T_s, T_in, G_u, uptake)
        net = outward - flux
        if self.n > 1:
            along = (T_s[1:] - T_s[:-1]) * self.G_cc
            net[:-1] += along
            net[1:] -= along
        if extra is not None:
            net += extra
        if self.G is not None:
            net -= self.G * (T_s - 25.0)
        C_s = self.C_s
        if self.latent is not None:
            z = (T_s - self.melting) / self.width
            C_s = C_s + self.latent / (self.width * np.sqrt(2 * np.pi)) * np.exp(-0.5 * z * z)
        rate[-1] = net / C_s
        return rate, T_f

    def mean(self, x):
        """Core temperature (n, B)."""
        if self.rings == 1:
            return x[0]
        out = self.w[0] * x[0]
        for r in range(1, self.rings):
            out = out + self.w[r] * x[r]
        return out


def integrate(logs):
    """Traces of many logs of one `shape`; the same numbers whatever company a log is in."""
    if len({x.shape for x in logs}) != 1:
        raise ValueError("logs of unlike shape do not run in one loop")
    b, substeps = _Batch(logs), logs[0].shape[-1]
    h = 1.0 / substeps
    shape = (b.K + 1, b.n, b.B_logs)
    core, surface, coolant = np.empty(shape), np.empty(shape), np.empty(shape)
    x = np.broadcast_to(b.start, (b.rings + 1, b.n, b.B_logs)).copy()
    on = np.zeros(b.B_logs, bool)
    water = None if b.water is None else np.tile(b.water[0], (b.n, 1))
    for k in range(b.K):
        G_u, uptake = b.G_u[k], b.uptake[k]
        extra = None if b.casing_heat is None else b.casing_heat[k]
        if b.fan is not None:
            hottest = x[-1].max(axis=0)
            on = np.where(on, hottest > b.fan[1], hottest > b.fan[0])
            ratio = np.where(on, b.fan[2], 1.0)
            G_u, uptake = G_u * ratio**0.63, uptake * ratio**-0.37
        if water is not None:
            taken = np.minimum(b.water[1] * np.maximum(x[-1] - b.water[2], 0.0), water)
            water = water - taken
            extra = -taken if extra is None else extra - taken
        a, slope = b.inlet[k], b.inlet[k + 1] - b.inlet[k]
        core[k], surface[k] = b.mean(x), x[-1]
        for j in range(substeps):
            rate, T_f = b.rates(k, x, a + slope * (j * h), G_u, uptake, extra)
            if j == 0:
                coolant[k] = T_f
            rate, _ = b.rates(k, x + (h / 2) * rate, a + slope * ((j + 0.5) * h), G_u, uptake, extra)
            x = x + h * rate
    core[-1], surface[-1] = b.mean(x), x[-1]
    coolant[-1] = b.film(x[-1], b.inlet[-1], b.G_u[-1], b.uptake[-1])[1]
    return [
        Trace(*(np.ascontiguousarray(z[:, :, i]) for z in (core, surface, coolant)), overpotential(t, core[:, :, i]))
        for i, t in enumerate(logs)
    ]


def overpotential(t, core):
    """Open-circuit minus terminal voltage of the mean cell, V: what makes the irreversible heat."""
    T = (core[1:] + core[:-1]) / 2 + KELVIN
    share = 1 + t.asymmetry * (t.rows < 0)
    R = t.R_e * np.exp(t.B * (1 / T - 1 / T_REF)) * share[:, None]
    out = t.rows * R.mean(axis=1) + t.drop - (t.entropic[:, None] * (T - T_REF)).mean(axis=1)
    if np.isfinite(t.exchange_current):
        I_0 = t.exchange_current * np.exp(-t.exchange_energy * (1 / T - 1 / T_REF))
        eta = 2 * GAS * T / FARADAY * np.arcsinh(np.abs(t.rows)[:, None] / (2 * I_0))
        out = out + np.sign(t.rows) * eta.mean(axis=1)
    return out
