"""Which held-out readings tell of charge that the training knows: by drives whose charge is written down here."""

from types import SimpleNamespace

import numpy as np

from bms_gateway.diagnosis.coverage import MEMORY_S, covered
from bms_gateway.thermal.drive import Span


def record(amps, soc, used, dt=10.0):
    """One reading after each interval."""
    amps, soc = np.asarray(amps, float), np.asarray(soc, float)
    drive = SimpleNamespace(dt=dt, N=len(amps), I=amps, I2=amps**2, soc=soc)
    return SimpleNamespace(drive=drive, spans=(Span(0, len(amps)),), row=np.arange(len(amps)), used=np.asarray(used))


def discharge(held, high=0.9, low=0.1, N=400):
    used = np.ones(N, bool)
    used[held] = False
    return record(np.full(N, 5.0), np.linspace(high, low, N), used)


def test_a_block_amid_a_discharge_is_covered_and_its_end_is_not():
    inner, last = slice(100, 140), slice(340, 400)
    assert covered([discharge(inner)])[inner].all()
    end = covered([discharge(last)])
    assert not end[350:].any()
    assert end[:340].all()


def test_a_wide_hole_is_not_covered():
    wide = slice(100, 220)
    assert not covered([discharge(wide)])[150]


def test_another_record_covers_it():
    last = slice(340, 400)
    whole = discharge(slice(0, 0))
    assert covered([discharge(last), whole]).all()


def test_a_rest_tells_nothing_of_its_charge_and_a_surface_remembers_for_a_while():
    """The discharge's end alone is held out; the rest behind it was trained, without current."""
    N = 400
    amps = np.where(np.arange(N) < 150, 5.0, 0.0)
    soc = np.where(np.arange(N) < 150, 0.9 - 0.8 * np.arange(N) / 150, 0.1)
    used = np.ones(N, bool)
    used[110:150] = False
    found = covered([record(amps, soc, used)])
    assert not found[120:150].any()
    assert not found[155]
    after = 150 + round(MEMORY_S / 10.0)
    assert found[after + 1 :].all()


def test_nothing_trained_covers_nothing():
    N = 50
    assert not covered([record(np.ones(N), np.linspace(1, 0, N), np.zeros(N, bool))]).any()
