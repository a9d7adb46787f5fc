"""What is put into our messages, and when: read back by cantools."""

import pickle
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from bms_gateway import __version__
from bms_gateway.engine import broadcast
from bms_gateway.engine.broadcast import Broadcast, Counts, State
from bms_gateway.engine.estimators import AVAILABLE_SD_K, Estimators
from bms_gateway.engine.inputs import Inputs
from bms_gateway.engine.sent import GATEWAY_MESSAGES, STRING_MESSAGES
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.identify import Estimate
from tests.engine.packs import database, plan
from tests.frames.payloads import OWN, parsed

S = 1_000_000_000
TEN = 1_700_000_000 * S  # a whole ten seconds: all cycles fall on it
COUNTS = Counts(321, 7, 11, 4000.25)


@cache
def dbc():
    return parsed(OWN)


def estimators(strings: int = 1) -> Estimators:
    return Estimators(plan(strings), Inputs(plan(strings), database()).wires)


def content(batch: FrameBatch, *, raw: bool = False) -> dict[str, dict]:
    """Signals by message; those of multiplexed messages all together."""
    found: dict[str, dict] = {}
    for can_id, data in zip(batch.can_id.tolist(), batch.data, strict=True):
        message = dbc().get_message_by_frame_id(can_id & 0x1FFF_FFFF)
        found.setdefault(message.name, {}).update(
            message.decode(bytes(data), decode_choices=False, scaling=not raw, allow_truncated=False)
        )
    return found


def said(of: Estimators, t1: int = TEN, state: State = State.RUNNING, *, raw: bool = False) -> dict[str, dict]:
    return content(Broadcast(of_plan(of), database()).encode(t1, of, state, COUNTS), raw=raw)


def of_plan(of: Estimators):
    return plan(len(of.strings))


def known(of: Estimators) -> Estimators:
    new, n = of.newest, len(of.newest.core)
    new.core[:] = 30.0 + np.arange(n) % 3  # 30, 31, 32, 30, 31, …
    new.core_sd[:] = 0.5 + 0.1 * np.arange(n)
    new.surface[:] = 25.0 - np.arange(n)
    new.quality[:] = np.arange(n) % 4
    new.centre[:] = 35.0 - (np.arange(n) - 1) % 4  # 34, 35, 34, 33, 34, …: not in the cell with the hottest core
    new.centre_sd[:] = 1.0 + 0.1 * np.arange(n)
    return of


def test_every_cell_is_said_with_its_band_its_surface_and_its_quality() -> None:
    of = known(estimators(2))
    told = said(of)
    for string in (0, 1):
        core = told[f"string_{string + 1}_core"]
        for k in range(4):
            n = 4 * string + k
            assert core[f"core_{k + 1:02}"] == pytest.approx(30.0 + n % 3)
            assert core[f"core_sd_{k + 1:02}"] == pytest.approx(0.5 + 0.1 * n, abs=0.03)
            assert core[f"surface_{k + 1:02}"] == pytest.approx(25.0 - n)
            assert core[f"quality_{k + 1:02}"] == n % 4


def test_the_hottest_and_the_coldest_cell_of_each_string_are_summed_up() -> None:
    told = said(known(estimators(2)))
    one, two = (told[f"string_{k}_summary"] for k in (1, 2))
    assert (one["hottest_core"], one["hottest_cell"], one["coldest_core"]) == pytest.approx((32.0, 3, 30.0))
    assert (one["hottest_sd"], one["hottest_quality"]) == pytest.approx((0.7, 2))
    assert (two["hottest_core"], two["hottest_cell"], two["coldest_core"]) == pytest.approx((32.0, 2, 30.0))
    assert (two["hottest_sd"], two["hottest_quality"]) == pytest.approx((1.0, 1))


def test_the_hottest_point_of_each_string_is_said_with_its_cell_its_band_and_its_core() -> None:
    told = said(known(estimators(2)))
    one, two = (told[f"string_{k}_hottest"] for k in (1, 2))
    assert (one["hottest_point"], one["hottest_point_cell"]) == pytest.approx((35.0, 2))
    assert (one["hottest_point_sd"], one["hottest_point_quality"]) == pytest.approx((1.1, 1))
    assert one["hottest_point_core"] == pytest.approx(31.0)
    assert (two["hottest_point"], two["hottest_point_cell"]) == pytest.approx((35.0, 2))
    assert (two["hottest_point_sd"], two["hottest_point_core"]) == pytest.approx((1.5, 32.0))


def test_a_hottest_point_known_too_badly_for_its_field_is_said_without_a_band() -> None:
    of = known(estimators())
    of.newest.centre_sd[:] = 14.0
    one = said(of, raw=True)["string_1_hottest"]
    assert one["hottest_point"] != 0xFFFF
    assert one["hottest_point_sd"] >= 0xFE


def test_a_string_of_which_nothing_is_known_has_no_hottest_point() -> None:
    nothing = said(estimators(), raw=True)["string_1_hottest"]
    assert (nothing["hottest_point"], nothing["hottest_point_core"]) == (0xFFFF, 0xFFFF)
    assert (nothing["hottest_point_cell"], nothing["hottest_point_sd"]) == (0xFF, 0xFF)
    assert nothing["hottest_point_quality"] == 0xF
    assert dbc().get_message_by_name("string_1_hottest").get_signal_by_name("hottest_point").raw_initial == 0xFFFF


def test_cells_that_nobody_knows_are_no_hottest_ones() -> None:
    of = known(estimators())
    of.newest.core[:] = [np.nan, 12.0, np.nan, 15.0]
    one = said(of)["string_1_summary"]
    assert (one["hottest_core"], one["hottest_cell"], one["coldest_core"]) == pytest.approx((15.0, 4, 12.0))
    of.newest.core[:] = np.nan
    nothing = said(of, raw=True)["string_1_summary"]
    assert {nothing[name] for name in ("hottest_core", "coldest_core")} == {0xFFFF}
    assert {nothing[name] for name in ("hottest_cell", "hottest_sd")} == {0xFF}
    assert nothing["hottest_quality"] == 0xF


def test_parameters_are_said_in_the_units_of_the_dbc_with_the_word_for_how_they_are_known() -> None:
    of = estimators()
    of.strings[0].estimates = (
        Estimate("R_e", 3.5e-3, 0.2e-3, "mOhm", "identified"),
        Estimate("R_c", 1.25, 0.11, "K/W", "not identifiable: too little current"),
        Estimate("R_u", 0.75, 0.05, "K/W", "learning"),
    )
    told = said(of)["string_1_parameters"]
    assert (told["R_e"], told["R_e_sd"], told["R_e_status"]) == pytest.approx((3.5, 0.2, 1))
    assert (told["R_c"], told["R_c_sd"], told["R_c_status"]) == pytest.approx((1.25, 0.11, 2))
    assert (told["R_u"], told["R_u_sd"], told["R_u_status"]) == pytest.approx((0.75, 0.05, 0))
    of.strings[0].estimates = (replace(of.strings[0].estimates[0], status="fixed: as ever"),)
    told = said(of, raw=True)["string_1_parameters"]
    assert told["R_e_status"] == 3
    assert told["R_c_status"] == 0xF
    assert (told["R_c"], told["R_c_sd"]) == (0xFF_FFFF, 0xFFFF)


def test_health_is_said_in_per_cent_and_before_commissioning_without_a_flag() -> None:
    of = estimators()
    s = of.strings[0]
    of.mismatches.excess[:] = 2.25
    s.mismatch.flag.level = 1
    s.ageing = SimpleNamespace(commissioned=True, flag=SimpleNamespace(level=2), growth=0.123, growth_sd=0.021)
    told = said(of)["string_1_health"]
    assert (told["R_e_flag"], told["mismatch_flag"]) == (2, 1)
    assert (told["R_e_growth"], told["R_e_growth_sd"], told["innovation"]) == pytest.approx((12.3, 2.1, 1.5))
    s.ageing.commissioned = False
    assert said(of)["string_1_health"]["R_e_flag"] == 0xF


def test_what_is_not_raised_names_no_thermocouple() -> None:
    of = estimators()
    s = of.strings[0]
    drift = SimpleNamespace(flag=SimpleNamespace(level=0), worst=3)
    flag = SimpleNamespace(level=1)
    cooling = SimpleNamespace(flag=flag, growth=-0.25)
    parts = {
        "current": SimpleNamespace(flag=SimpleNamespace(level=0)),
        "mismatch": s.mismatch,
        "cells": None,
        "heat": (),
    }
    ageing = SimpleNamespace(commissioned=True, flag=SimpleNamespace(level=3))
    s.health = SimpleNamespace(commissioned=True, ageing=ageing, cooling=cooling, drift=drift, **parts)
    flags = said(of, raw=True)["string_1_flags"]
    words = ("ageing", "cooling", "thermocouple", "current", "mismatch")
    assert [flags[f"{word}_flag"] for word in words] == [3, 1, 0, 0, 0]
    assert flags["thermocouple_cell"] == 0xFF
    drift.flag.level = 2
    told = said(of)["string_1_flags"]
    assert (told["thermocouple_flag"], told["thermocouple_cell"]) == (2, 3)
    assert told["R_u_growth"] == pytest.approx(-25.0)


def test_each_row_of_the_table_fills_its_own_signal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is added to the table leaves under its own name: rows are given different values and read back."""

    def chosen(signals: tuple) -> list[float]:
        return [s.low + (3 + i) * s.scale if s.table is None else min(i, s.high) for i, s in enumerate(signals)]

    def with_values(m):
        parts = tuple(replace(p, values=lambda _, p=p: chosen(p.signals)) for p in m.parts)
        return replace(m, parts=parts)

    for name in ("STRING_MESSAGES", "GATEWAY_MESSAGES"):
        monkeypatch.setattr(broadcast, name, tuple(with_values(m) for m in getattr(broadcast, name)))
    told = said(estimators())
    for m in (*STRING_MESSAGES, *GATEWAY_MESSAGES):
        found = told[m.name if m in GATEWAY_MESSAGES else f"string_1_{m.name}"]
        for c in range(1, 5) if m.of_cells else (1,):
            for p in m.parts:
                for s, value in zip(p.signals, chosen(p.signals), strict=True):
                    assert found[s.name.format(c=c)] == pytest.approx(value, abs=0.51 * s.scale), (m.name, s.name)


def test_the_gateway_says_how_it_does() -> None:
    told = said(estimators(), state=State.DEGRADED)
    status, info = told["gateway_status"], told["gateway_info"]
    assert [status[x] for x in ("state", "frame_rate", "rejected_samples", "dropped_frames")] == [2, 321, 7, 11]
    assert info["uptime"] == 4000
    version = [info[f"version_{part}"] for part in ("major", "minor", "patch")]
    assert version == [int(part) for part in __version__.split(".")]


def test_every_message_goes_out_in_its_cycle_in_the_order_of_the_strings_and_stamped_with_the_tick() -> None:
    of = estimators(2)
    sender = Broadcast(plan(2), database())
    batches = {t: sender.encode(t, of, State.RUNNING, COUNTS) for t in range(TEN, TEN + 21 * S, S // 2)}
    seen: dict[int, list[int]] = {}
    for t, batch in batches.items():
        assert (batch.time_ns == t).all()
        assert batch.time_ns.dtype == np.int64
        for can_id in set(batch.can_id.tolist()):
            seen.setdefault(can_id, []).append(t)
    assert set(seen) == set(sender.cycles)
    for can_id, times in seen.items():
        cycle = dbc().get_message_by_frame_id(can_id & 0x1FFF_FFFF).cycle_time * 1_000_000
        assert sender.cycles[can_id] == cycle
        assert times == list(range(TEN, TEN + 21 * S, cycle))
    names = [dbc().get_message_by_frame_id(c & 0x1FFF_FFFF).name for c in batches[TEN].can_id.tolist()]
    parts = (
        ["core"] * 4
        + ["summary", "hottest"]
        + ["parameters"] * 3
        + ["health", "flags"]
        + ["growth"] * 4
        + ["heat"] * 4
        + ["forecast"] * 4
    )
    assert names == [f"string_{k}_{p}" for k in (1, 2) for p in parts] + ["gateway_status", "gateway_info"]


def test_a_broadcast_goes_to_another_process() -> None:
    """A config that is read again is made into an engine in a process of its own."""
    of = known(estimators())
    there = pickle.loads(pickle.dumps(Broadcast(plan(1), database())))
    assert content(there.encode(TEN, of, State.RUNNING, COUNTS)) == said(of)


def test_states_are_those_of_the_dbc() -> None:
    choices = dbc().get_message_by_name("gateway_status").get_signal_by_name("state").choices
    named = {str(text).upper(): value for value, text in choices.items()}
    named["SILENT"] = named["BUS SILENT"]
    assert [named[s.name] for s in State] == [s.value for s in State] == [0, 1, 2, 3]


def test_every_band_that_is_sent_has_its_place_in_the_dbc() -> None:
    for message, name in (("string_1_core", "core_sd_01"), ("string_1_summary", "hottest_sd")):
        largest = dbc().get_message_by_name(message).get_signal_by_name(name).maximum
        assert 12.0 <= AVAILABLE_SD_K <= largest < AVAILABLE_SD_K + 1.0
