"""The catalogue as a contract: names, order, priors; effects of a user's own; nothing at the neutral value."""

from importlib.metadata import EntryPoint

import numpy as np
import pytest

from bms_gateway.errors import ConfigError
from bms_gateway.thermal import effects
from bms_gateway.thermal.effects import Effect, EffectParameter, catalogue, effect_named
from bms_gateway.thermal.physics import Physics
from tests.thermal.balances import drive, model, place, states, values
from tests.thermal.effect_fields import FIELDS

# name: (node, place, plausibility), then each parameter as (shown unit, prior, sd, lower, upper), in that unit
INF_A = 1e5
CONTRACT = {
    "entropic_heat": (
        ("core", "string", 0.0),
        dict.fromkeys(("dUdT", "dUdT_1", "dUdT_2", "dUdT_3", "dUdT_4"), ("mV/K", 0, 0.25, -1.5, 1.5)),
    ),
    "voltage_heat": (
        ("core", "string", -3.0),
        {"U": ("V", 3.3, 0.4, 1.2, 4.8)} | {f"U_{k}": ("V", 0, 0.2, -1, 1) for k in (1, 2, 3, 4, 5)},
    ),
    "resistance_temperature": (("core", "string", 0.0), {"B": ("K", 2500, 1500, -1000, 8000)}),
    "resistance_soc": (("core", "string", -1.5), {"s_1": ("1", 0, 0.3, -2, 2), "s_2": ("1", 0, 0.3, -2, 2)}),
    "resistance_asymmetry": (("core", "string", -1.5), {"a": ("1", 0, 0.3, -0.7, 2)}),
    "charge_transfer": (
        ("core", "string", -1.0),
        {"I_0": ("A", 20, "log 1.5", 0.01, INF_A), "E": ("K", 5000, 2000, 0, 15000)},
    ),
    "hysteresis": (("core", "string", -3.0), {"V": ("mV", 0, 20, 0, 200), "Q": ("Ah", 0.15, "log 1.0", 0.002, 5)}),
    "polarization": (
        ("core", "string", -1.5),
        {"R_1": ("mOhm", 0, 2, 0, 20), "tau": ("s", 40, "log 0.7", 5, 400)},
    ),
    "radial_gradient": (("core", "string", -1.5), {"phi": ("1", 0, 0.6, 0, 1)}),
    "resistance_drift": (("core", "string", -3.0), {"a": ("1/h", 0, 0.3, -1, 3)}),
    "cooling_drift": (("surface", "string", -3.0), {"a": ("1/h", 0, 0.3, -1, 3)}),
    "flow_dependent_cooling": (("surface", "string", -1.5), {"n": ("1", 0, 0.5, -0.5, 2)}),
    "natural_convection": (("surface", "string", -1.5), {"n": ("1", 0, 0.25, -0.3, 1)}),
    "ambient_loss": (("surface", "string", -1.5), {"G": ("W/K", 0, 0.2, -0.3, 2), "P": ("W", 0, 2, -40, 40)}),
    "core_loss": (("core", "string", -1.5), {"G": ("W/K", 0, 0.2, -0.3, 2), "P": ("W", 0, 2, -40, 40)}),
    "surface_joule": (("surface", "string", -3.0), {"R_s": ("mOhm", 0, 0.5, -1, 5)}),
    "busbar_joule": (("surface", "string", -3.0), {"R_s": ("mOhm", 0, 0.7, -1, 5)}),
    "end_plate": (("surface", "string", -3.0), {"G": ("W/K", 0, 0.2, -0.3, 2), "P": ("W", 0, 2, -40, 40)}),
    "coolant_delay": (("coolant", "string", -3.0), {"tau": ("s", 0, 15, 0, 120)}),
    "coolant_bypass": (("coolant", "gap", -3.0), {"b": ("1", 0, 0.3, -0.3, 0.9)}),
    "cell_resistance": (("core", "cell", -3.0), {"a": ("1", 0, 0.3, -0.7, 4)}),
    "cell_cooling": (("surface", "cell", -3.0), {"a": ("1", 0, 0.4, -0.7, 5)}),
    "cell_conduction": (("core", "cell", -3.0), {"a": ("1", 0, 0.6, -0.7, 6)}),
    "neighbour_heat": (("surface", "cell", -3.0), {"P": ("W", 0, 0.8, -8, 8)}),
    "phase_change": (
        ("surface", "string", -3.0),
        {"L": ("J", 0, 1000, 0, 10000), "T_m": ("°C", 40, 20, -20, 120), "w": ("K", 0.7, "log 0.35", 0.2, 3)},
    ),
    "thermocouple_lag": (("reading", "string", -3.0), {"tau": ("s", 0, 6, 0, 60)}),
    "thermocouple_offset": (("reading", "sensor", -3.0), {"b": ("K", 0, 1, -8, 8)}),
    "thermocouple_contact": (("reading", "sensor", -3.0), {"g": ("1", 0, 0.2, -0.2, 0.8)}),
    "inlet_offset": (("coolant", "string", -3.0), {"b": ("K", 0, 1, -5, 5)}),
    "current_offset": (("input", "string", -3.0), {"b": ("A", 0, 2, -10, 10)}),
}
SIGNALS = {
    "voltage_heat": {"voltage", "soc"},
    "resistance_soc": {"soc"},
    "flow_dependent_cooling": {"flow"},
}
ONE_SIDED = {
    "coolant_delay",
    "thermocouple_lag",
    "polarization",
    "phase_change",
    "radial_gradient",
    "hysteresis",
    "charge_transfer",
}


def test_names_and_order_are_the_contracts():
    assert list(catalogue()) == list(CONTRACT)


@pytest.mark.parametrize("name", CONTRACT)
def test_places_and_priors_are_the_contracts(name):
    e = effect_named(name)
    (node, where, odds), expected = CONTRACT[name]
    assert (e.node, e.place, e.plausibility) == (node, where, odds)
    assert set(e.signals) == SIGNALS.get(name, set())
    assert e.one_sided == (name in ONE_SIDED)
    found = {}
    for p in e.parameters:
        sd = f"log {p.sd}" if p.log else p.sd / p.to_si
        found[p.name] = (p.unit, p.prior / p.to_si, sd, p.lower / p.to_si, p.upper / p.to_si)
    assert found.keys() == expected.keys()
    for parameter, (unit, *numbers) in expected.items():
        assert found[parameter][0] == unit
        for got, wanted in zip(found[parameter][1:], numbers, strict=True):
            assert got == (wanted if isinstance(wanted, str) else pytest.approx(wanted, abs=1e-12)), parameter


@pytest.mark.parametrize("name", CONTRACT)
def test_every_effect_explains_itself(name):
    e = effect_named(name)
    for text in (e.title, e.equation, e.signature, e.needs):
        assert text
        assert len(text) <= 110
        assert not text.endswith(".")
    assert set(e.confused_with) <= set(catalogue()) - {name}
    assert e.hooks()
    for p in e.parameters:
        assert p.description
        assert p.lower <= p.prior <= p.upper
        assert p.lower <= p.probe <= p.upper
        assert p.neutral is None or p.lower <= p.neutral <= p.upper
        assert not p.log or p.lower > 0
    first = e.parameters[0]
    if name != "voltage_heat":
        assert first.neutral not in (None, first.probe)
    if e.one_sided:
        assert first.neutral in (first.lower, first.upper)
    for start in e.starts(20.0, 50.0):
        for parameter, value in start.items():
            p = e.parameter(parameter)
            assert p.lower <= value <= p.upper


@pytest.mark.parametrize("name", [n for n in CONTRACT if n != "voltage_heat"])
@pytest.mark.parametrize("cells", [3, 12])
def test_nothing_changes_at_the_neutral_value(name, cells):
    N, e, u = 50, effect_named(name), drive(50)
    bare = Physics(model(cells))
    own = Physics(model(cells, (name, place(name), values(name))))
    X = states(N, cells, e.states)
    v = own.numbers()
    memory, _ = own.memory(u, v)
    short = X[:, : 2 * cells]
    rates, expected = own.rates(X, u, v, memory), bare.rates(short, u, bare.numbers(), {})
    if e.states and name == "radial_gradient":  # a departure that is there at the start is pushed out
        X[:, 2 * cells :] = 0.0
        rates = own.rates(X, u, v, memory)
    # no exchange current is infinite: the bound leaves a quarter of a µΩ of 3.5 mΩ
    tolerance = 5e-4 if name == "charge_transfer" else 1e-12
    assert np.allclose(rates[:, : 2 * cells], expected, rtol=tolerance, atol=tolerance)
    assert np.allclose(own.readings(X, u, v, memory), bare.readings(short, u, bare.numbers(), {}), atol=1e-12)


@pytest.mark.parametrize("name", CONTRACT)
def test_the_probe_is_clearly_visible_and_mild(name):
    cells, u = 3, drive(400)
    X = states(400, cells, effect_named(name).states, low=20.0, high=45.0)
    X[:, 0 : 2 * cells : 2] += 10.0
    if name == "radial_gradient":
        X[:, 2 * cells :] = 0.0
    if name == "voltage_heat":
        u = drive(400, V=np.full(400, 3.2), IV=3.2 * u.I)
    bare, own = Physics(model(cells)), Physics(model(cells, (name, place(name), values(name, by="probe"))))
    v = own.numbers()
    memory, _ = own.memory(u, v)
    short = X[:, : 2 * cells]
    heat = (own.rates(X, u, v, memory)[:, : 2 * cells] - bare.rates(short, u, bare.numbers(), {})) * np.tile(
        [268.0, 18.8], cells
    )
    off = own.readings(X, u, v, memory) - bare.readings(short, u, bare.numbers(), {})
    watts, kelvins = np.sqrt(np.mean(heat**2, axis=0)).max(), np.sqrt(np.mean(off**2, axis=0)).max()
    assert 0.05 < watts < 30.0 or 0.05 < kelvins < 20.0, (watts, kelvins)


@pytest.mark.parametrize("name", CONTRACT)
@pytest.mark.parametrize("N", [1, 100])
@pytest.mark.parametrize("cells", [3, 12])
def test_one_interval_or_many_at_once_are_the_same(name, N, cells):
    u = drive(N)
    own = Physics(model(cells, (name, place(name), values(name, by="probe"))))
    X, v = states(N, cells, effect_named(name).states), own.numbers()
    memory, _ = own.memory(u, v)
    rates, readings = own.rates(X, u, v, memory), own.readings(X, u, v, memory)
    assert rates.shape == X.shape
    assert readings.shape == (N, cells)
    for k in (0, N - 1):
        one = type(u)(u.dt, *(getattr(u, f)[k : k + 1] for f in FIELDS), known=u.known)
        here = {key: m[k : k + 1] for key, m in memory.items()}
        assert np.allclose(own.rates(X[k : k + 1], one, v, here)[0], rates[k], rtol=1e-13, atol=1e-13)
        assert np.allclose(own.readings(X[k : k + 1], one, v, here)[0], readings[k], rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("name", CONTRACT)
@pytest.mark.parametrize("by", ["lower", "upper"])
def test_absurd_inputs_stay_finite(name, by):
    cells, N = 3, 400
    rng = np.random.default_rng(3)
    amps = rng.choice([-1000.0, -1e-9, 0.0, 1e-9, 1000.0], N)
    u = drive(
        N,
        I=amps,
        I2=np.maximum(amps * amps, rng.choice([0.0, 1e6], N)),
        I_abs=np.maximum(np.abs(amps), rng.choice([0.0, 1000.0], N)),
        T_in=rng.uniform(-40, 150, N),
        flow=rng.choice([0.01, 1.0, 10.0], N),
        soc=rng.choice([-0.1, 0.0, 0.5, 1.0, 1.1], N),
        hours=rng.uniform(0, 1000, N),
    )
    own = Physics(model(cells, (name, place(name), values(name, by=by))))
    X, v = states(N, cells, effect_named(name).states, low=-40.0, high=150.0), own.numbers()
    memory, carry = own.memory(u, v)
    start = own.start(X[:, 0:6:2], X[:, 1:6:2], v)
    with np.errstate(all="raise", under="ignore"):
        assert np.isfinite(own.rates(X, u, v, memory)).all()
        assert np.isfinite(own.readings(X, u, v, memory)).all()
    assert np.isfinite(start).all()
    assert all(np.isfinite(c).all() for c in carry.values())


@pytest.mark.parametrize("name", CONTRACT)
def test_the_arrays_of_others_are_left_alone(name):
    cells, u = 3, drive(20)
    own = Physics(model(cells, (name, place(name), values(name, by="probe"))))
    X, v = states(20, cells, effect_named(name).states), own.numbers()
    memory, _ = own.memory(u, v)
    for field in FIELDS:
        getattr(u, field).flags.writeable = False
    X.flags.writeable = False
    for symbol in ("C_c", "C_s", "R_e", "R_c", "R_u"):
        getattr(v.string, symbol).flags.writeable = False
    own.rates(X, u, v, memory)
    own.readings(X, u, v, memory)


def test_what_a_record_cannot_tell_is_left_out():
    N = 100
    wide, narrow = np.linspace(0.9, 0.1, N), np.linspace(0.7, 0.55, N)
    entropic = effect_named("entropic_heat").determined
    assert entropic(drive(N, soc=narrow)) == ("dUdT",)
    assert entropic(drive(N, soc=wide)) == ("dUdT", "dUdT_1", "dUdT_2", "dUdT_3", "dUdT_4")
    assert entropic(drive(N, soc=np.linspace(0.7, 0.4, N))) == ("dUdT", "dUdT_2", "dUdT_3")
    uncounted = drive(N, soc=wide)
    uncounted = type(uncounted)(1.0, *(getattr(uncounted, f) for f in FIELDS), known=frozenset())
    assert entropic(uncounted) == ("dUdT",)
    assert effect_named("flow_dependent_cooling").determined(drive(N, flow=np.ones(N))) == ()
    assert effect_named("flow_dependent_cooling").determined(drive(N)) == ("n",)
    assert effect_named("coolant_delay").determined(drive(N, T_in=np.full(N, 22.0))) == ()
    assert effect_named("resistance_asymmetry").determined(drive(N, I=np.full(N, 10.0))) == ()
    assert effect_named("hysteresis").determined(drive(N, I=np.full(N, 10.0))) == ()
    assert effect_named("resistance_soc").determined(drive(N, soc=narrow)) == ("s_1",)
    assert effect_named("resistance_soc").determined(drive(N, soc=wide)) == ("s_1", "s_2")
    assert effect_named("voltage_heat").determined(drive(N, soc=narrow)) == ("U", "U_3", "U_4")


class Sun(Effect):
    """Somebody's own effect."""

    name = "sun"
    title = "the sun on the first cell"
    equation = "surface heat -> surface heat + P"
    signature = "warm by day"
    node = "surface"
    parameters = (EffectParameter("P", "heat", "W", 1.0, 0.0, 5.0, 0.0, 50.0, probe=2.0),)

    def surroundings(self, z, p, at):
        z.surface = z.surface + p["P"] * np.eye(1, z.cells)[0]


class Squatter(Sun):
    name = "entropic_heat"


NOT_AN_EFFECT = 3


@pytest.fixture
def installed(monkeypatch):
    """Entry points as if distributions had brought them."""

    def install(**points):
        listed = [EntryPoint(name, value, effects.GROUP) for name, value in points.items()]
        monkeypatch.setattr(effects, "entry_points", lambda group: [e for e in listed if e.group == group])
        catalogue.cache_clear()

    yield install
    monkeypatch.undo()
    catalogue.cache_clear()


def test_an_effect_of_ones_own_works_like_the_others(installed):
    installed(sun=f"{__name__}:Sun")
    assert [*catalogue()][-1] == "sun"
    own = Physics(model(3, ("sun", None, {"P": 4.0})))
    bare = Physics(model(3))
    u, X = drive(5), states(5, 3)
    gain = own.rates(X, u, own.numbers(), {}) - bare.rates(X, u, bare.numbers(), {})
    assert gain == pytest.approx(np.tile([0, 4.0 / 18.8, 0, 0, 0, 0], (5, 1)), abs=1e-12)


def test_an_installed_package_brings_its_effect(monkeypatch, tmp_path):
    (tmp_path / "rain_on_cells.py").write_text(
        "from bms_gateway.thermal.effects import Effect, EffectParameter\n"
        "class Rain(Effect):\n"
        "    name, title, equation, signature = 'rain', 'rain', 'surface heat -> surface heat - P', 'wet'\n"
        "    node = 'surface'\n"
        "    parameters = (EffectParameter('P', 'heat', 'W', 1.0, 0.0, 5.0, 0.0, 50.0, probe=2.0),)\n"
    )
    info = tmp_path / "rain_on_cells-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: rain-on-cells\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[bms_gateway.effects]\nrain = rain_on_cells:Rain\n")
    monkeypatch.syspath_prepend(tmp_path)
    catalogue.cache_clear()
    try:
        assert effect_named("rain").parameter("P").probe == 2.0
        assert list(catalogue()) == [*CONTRACT, "rain"]
    finally:
        monkeypatch.undo()
        catalogue.cache_clear()


@pytest.mark.parametrize(
    ("points", "says"),
    [
        (
            {"sun": "no.such.module:Sun"},
            r"effect 'sun' of no\.such\.module:Sun: cannot be loaded: No module named 'no'",
        ),
        ({"sun": f"{__name__}:Moon"}, "effect 'sun' .* cannot be loaded: .*Moon"),
        ({"sun": f"{__name__}:NOT_AN_EFFECT"}, "is not a class derived from Effect"),
        ({"sun": f"{__name__}:Squatter"}, "the name 'entropic_heat' is taken"),
    ],
)
def test_a_broken_entry_point_is_one_clear_line(installed, points, says):
    installed(**points)
    with pytest.raises(ConfigError, match=says) as caught:
        catalogue()
    assert "\n" not in str(caught.value)


def test_an_unknown_effect_names_the_nearest():
    with pytest.raises(ConfigError, match="did you mean 'entropic_heat'"):
        effect_named("entropyc_heat")
