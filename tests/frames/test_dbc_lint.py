"""The DBC that the project ships is fit to be handed to others: cantools parses it, and these rules hold."""

import re
import subprocess
import sys
from itertools import combinations
from typing import Any

import pytest
from cantools.database.can import Message, Signal

from bms_gateway.engine.sent import GATEWAY_MESSAGES, STRING_MESSAGES
from bms_gateway.frames.batch import EXTENDED
from bms_gateway.frames.own_dbc import MAX_CELLS, MAX_STRINGS, input_messages, own_signal, string_message
from bms_gateway.frames.quality import Quality
from tests.frames.payloads import OWN, ROOT, loaded, parsed

DB = parsed(OWN)
MESSAGES = list(DB.messages)
SIGNALS = [(m, s) for m in MESSAGES for s in m.signals]
IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,31}")
AUTOMATIC = {"crc", "counter", "mux"}


def attribute(thing: Any, name: str) -> Any:
    stated = thing.dbc.attributes.get(name)
    definition = DB.dbc.attribute_definitions[name]
    value = definition.default_value if stated is None else stated.value
    return definition.choices[value] if definition.choices and isinstance(value, int) else value


def bits(s: Signal) -> set[int]:
    assert s.byte_order == "little_endian"
    return set(range(s.start, s.start + s.length))


def test_the_file_is_what_its_script_writes() -> None:
    code = "import runpy, sys; sys.stdout.write(runpy.run_path(sys.argv[1])['dbc']())"
    made = subprocess.run(
        [sys.executable, "-c", code, str(ROOT / "dbc" / "generate.py")], check=True, capture_output=True, text=True
    )
    assert made.stdout == OWN.read_text(encoding="ascii"), "run: python dbc/generate.py"


def test_identifiers_names_and_data_ids_are_unique() -> None:
    assert len({m.frame_id for m in MESSAGES}) == len(MESSAGES)
    assert len({m.name for m in MESSAGES}) == len(MESSAGES)
    assert len({attribute(m, "E2EDataID") for m in MESSAGES}) == len(MESSAGES)
    for m in MESSAGES:
        assert len({s.name for s in m.signals}) == len(m.signals)


def test_names_fit_every_tool() -> None:
    for name in [*(m.name for m in MESSAGES), *(s.name for _, s in SIGNALS), *(n.name for n in DB.nodes)]:
        assert IDENTIFIER.fullmatch(name), name


def test_signals_fit_and_those_sent_together_do_not_overlap() -> None:
    for m in MESSAGES:
        assert m.length == 8
        for s in m.signals:
            assert max(bits(s)) < 64, s.name
        for a, b in combinations(m.signals, 2):
            together = not (a.multiplexer_ids and b.multiplexer_ids) or set(a.multiplexer_ids) & set(b.multiplexer_ids)
            assert not (together and bits(a) & bits(b)), (m.name, a.name, b.name)


def test_identifiers_are_j1939_proprietary_b_from_the_right_node() -> None:
    address = {n.name: n.dbc.attributes["NmStationAddress"].value for n in DB.nodes}
    assert len(set(address.values())) == len(address)
    for m in MESSAGES:
        assert m.is_extended_frame
        assert m.protocol == "j1939"
        assert m.frame_id >> 26 == 6
        assert m.frame_id >> 16 & 0x3FF == 0xFF
        assert m.frame_id & 0xFF == address[m.senders[0]]
        assert attribute(m, "E2EDataID") == m.frame_id >> 8 & 0xFFFF


def test_senders_and_receivers_are_nodes_and_differ() -> None:
    nodes = {n.name for n in DB.nodes}
    for m in MESSAGES:
        assert len(m.senders) == 1
        assert set(m.senders) <= nodes
        for s in m.signals:
            assert s.receivers
            assert set(s.receivers) <= nodes - set(m.senders)


def test_everything_is_commented_with_unit_and_cycle_time() -> None:
    assert all(n.comment for n in DB.nodes)
    for m in MESSAGES:
        assert m.comment, m.name
        assert m.cycle_time in (100, 1000, 10000), m.name
        for s in m.signals:
            assert s.comment, s.name
            assert s.unit, s.name


def test_cycle_times_are_those_promised() -> None:
    promised = {"electrical": 100, "parameters": 10000, "health": 10000, "growth": 10000, "gateway_info": 10000}
    for m in MESSAGES:
        kind = m.name if m.name.startswith("gateway") else m.name.split("_", 2)[2]
        assert m.cycle_time == promised.get(kind, 1000)


def test_ranges_are_declared_and_can_be_carried() -> None:
    for _, s in SIGNALS:
        assert s.minimum is not None
        assert s.maximum is not None
        assert s.minimum < s.maximum
        low, high = s.offset, (2**s.length - 1) * s.scale + s.offset
        assert low - 1e-9 <= s.minimum, s.name
        assert s.maximum <= high + 1e-9, s.name


def error_from(s: Signal) -> int:
    return 0xFE << (s.length - 8) if s.length >= 8 else 2**s.length - 2


def test_not_available_and_error_are_representable_and_outside_the_valid_range() -> None:
    for _, s in SIGNALS:
        convention = attribute(s, "RawConvention")
        assert convention == ("None" if s.name in AUTOMATIC else "J1939")
        if convention == "J1939":
            assert s.length in (4, 8, 16, 24)
            assert not s.is_signed
            assert (s.maximum - s.offset) / s.scale < error_from(s), s.name


def test_start_values_are_not_available_or_zero_and_within_the_bits() -> None:
    for _, s in SIGNALS:
        assert s.raw_initial is not None, s.name
        expected = 0 if s.name in AUTOMATIC else 2**s.length - 1
        assert s.raw_initial == expected


def test_value_tables_name_every_valid_raw_value_and_both_special_ones() -> None:
    tabled = [s for _, s in SIGNALS if s.conversion.choices]
    assert tabled
    for s in tabled:
        valid = set(range(int(s.minimum), int(s.maximum) + 1))
        assert set(s.conversion.choices) == valid | {14, 15}, s.name
        assert str(s.conversion.choices[14]) == "error"
        assert str(s.conversion.choices[15]) == "not available"
    four_bits = {s.name for _, s in SIGNALS if s.length == 4} - AUTOMATIC
    assert four_bits == {s.name for s in tabled}


def test_the_table_of_qualities_is_ours() -> None:
    table = DB.dbc.value_tables["Quality"]
    for quality in Quality:
        label = str(table[int(quality)])
        assert "reserved" not in label
    words = {Quality.GOOD: "good", Quality.STUCK: "stuck", Quality.CRC: "crc", Quality.ESTIMATED: "estimated"}
    assert all(str(table[int(q)]) == word for q, word in words.items())


def multiplexer(m: Message) -> Signal | None:
    found = [s for s in m.signals if s.is_multiplexer]
    assert len(found) <= 1
    return found[0] if found else None


def test_multiplexers_cover_their_range_and_nothing_else() -> None:
    for m in MESSAGES:
        switch = multiplexer(m)
        used = {v for s in m.signals for v in s.multiplexer_ids or ()}
        if switch is None:
            assert not used
        else:
            assert used == set(range(int(switch.minimum), int(switch.maximum) + 1)), m.name
            assert max(used) < 2**switch.length


def test_every_message_is_protected_by_the_named_profile() -> None:
    for m in MESSAGES:
        assert attribute(m, "E2EProfile") == "AUTOSAR_P01_1A"
        crc, counter = m.get_signal_by_name("crc"), m.get_signal_by_name("counter")
        assert (crc.start, crc.length) == (0, 8)
        assert (counter.start, counter.length, counter.maximum) == (8, 4, 14)


@pytest.mark.parametrize("k", range(1, MAX_STRINGS + 1))
def test_every_channel_has_a_signal_sent_by_the_battery_in_si(k: int) -> None:
    database = loaded(OWN)
    units = {"current": "A", "voltage": "V", "coolant_inlet": "degC", "coolant_flow": "m3/s", "soc": "1"}
    for quantity, unit in units.items():
        info = database.resolve(own_signal(k, quantity))
        assert info.unit == unit
        assert database.messages[info.message].senders == ("BMS",)
        assert info.message in input_messages(k)
    for quantity, unit in (("surface", "degC"), ("cell_voltage", "V")):
        paths = {own_signal(k, quantity, c) for c in range(1, MAX_CELLS + 1)}
        assert len(paths) == MAX_CELLS
        assert {database.resolve(p).unit for p in paths} == {unit}
    assert database.resolve(own_signal(k, "current")).minimum == -8000  # discharge is positive, charge must fit too


def test_what_the_gateway_sends_is_the_table_in_every_string_and_cell() -> None:
    database = loaded(OWN)
    expected = {m.name for m in GATEWAY_MESSAGES}
    for k in range(1, MAX_STRINGS + 1):
        for m in STRING_MESSAGES:
            name = string_message(k, m.name)
            expected.add(name)
            cells = range(1, MAX_CELLS + 1)
            parts = dict.fromkeys(cells, m.parts[0]) if m.of_cells else dict(enumerate(m.parts))
            for mux, part in parts.items():
                for s in part.signals:
                    found = database.resolve(f"{name}.{s.name.format(c=mux)}")
                    assert [x.values for x in found.mux] == ([(mux,)] if m.mux else [])
                    assert (found.unit, found.minimum) == (s.unit, pytest.approx(s.low))
    ours = {m.name for m in database.messages.values() if m.senders == ("BMS_GATEWAY",)}
    assert ours == expected
    assert len(ours) == 2 + 9 * MAX_STRINGS
    assert all(m.can_id & EXTENDED for m in database.messages.values())


def test_a_message_of_the_gateway_holds_nothing_beside_its_rows() -> None:
    counts = {m.name: len(DB.get_message_by_name(m.name).signals) for m in GATEWAY_MESSAGES}
    assert counts == {"gateway_status": 6, "gateway_info": 6}
    for m in STRING_MESSAGES:
        rows = sum(len(p.signals) for p in m.parts) * (MAX_CELLS if m.of_cells else 1)
        held = DB.get_message_by_name(string_message(1, m.name)).signals
        assert len(held) == rows + 2 + (m.mux is not None)
