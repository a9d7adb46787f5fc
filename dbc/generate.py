"""Write `bms_gateway.dbc`: the messages that the gateway reads by default and those that it sends.

Eight strings of up to 18 cells give about a thousand signals, too many to keep right by hand. What the gateway sends is
the table of `bms_gateway/engine/sent.py`; what it reads is below. Run ``python dbc/generate.py`` after a change of one
of them, then ``python dbc/tabulate.py``; tests fail while a file is out of date.

Layout rules: little-endian; every message has eight bytes; AUTOSAR E2E profile 1 variant 1A takes byte 0 (CRC) and the
low half of byte 1 (counter); raw values from 0xFE in the top byte on are J1939's error and not-available ranges.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bms_gateway.engine.sent import GATEWAY_MESSAGES, STRING_MESSAGES
from bms_gateway.engine.sent_message import Message as SentMessage
from bms_gateway.frames.own_dbc import MAX_CELLS as CELLS
from bms_gateway.frames.own_dbc import MAX_STRINGS as STRINGS
from bms_gateway.frames.own_dbc import string_message
from bms_gateway.frames.own_layout import VALUE_TABLES, SignalLayout, celsius

PER_FRAME = 3
"""Cells per multiplexer value: three 16-bit values are what six bytes hold."""

GATEWAY, BMS = "BMS_GATEWAY", "BMS"
GATEWAY_ADDRESS, BMS_ADDRESS = 0xA8, 0xA5
"""J1939 source addresses from the range 128…247 that is left to the network's designer."""
PRIORITY = 6
"""J1939's default for proprietary messages."""
E2E_PROFILE = "AUTOSAR_P01_1A"


@dataclass
class Signal:
    """One signal; `mux` is None outside the multiplexer, "M" for the multiplexer itself, else its value."""

    layout: SignalLayout
    mux: int | str | None = None
    convention: str = "J1939"

    @property
    def name(self) -> str:
        """Name within the message."""
        return self.layout.name

    @property
    def start_raw(self) -> int:
        """Not available until something is known; counters, check sums and multiplexers begin at zero."""
        return (1 << self.layout.size) - 1 if self.convention == "J1939" else 0


@dataclass
class Message:
    """One message."""

    name: str
    group: int
    sender: str
    cycle_ms: int
    comment: str
    signals: list[Signal] = field(default_factory=list)

    @property
    def frame_id(self) -> int:
        """29-bit identifier of a proprietary B parameter group, with the DBC's mark of extended frames."""
        address = GATEWAY_ADDRESS if self.sender == GATEWAY else BMS_ADDRESS
        return 0x8000_0000 | PRIORITY << 26 | 0xFF << 16 | self.group << 8 | address

    @property
    def data_id(self) -> int:
        """Parameter group number: no two messages share it."""
        return 0xFF00 | self.group

    @property
    def receiver(self) -> str:
        """The other node."""
        return BMS if self.sender == GATEWAY else GATEWAY


def protection() -> list[Signal]:
    """CRC and counter of AUTOSAR E2E profile 1, variant 1A."""
    crc = "CRC-8 (polynomial 0x1D, start 0, final XOR 0) over the data ID, low byte first, and bytes 1 to 7."
    counter = "Alive counter 0 to 14; in multiplexed messages each multiplexer value counts for itself."
    return [
        Signal(SignalLayout("crc", 0, 8, 1, 0, 0, 255, "1", crc), convention="None"),
        Signal(SignalLayout("counter", 8, 4, 1, 0, 0, 14, "1", counter), convention="None"),
    ]


def selector(start: int, size: int, last: int, comment: str, first: int = 0) -> Signal:
    """Build the multiplexer."""
    return Signal(SignalLayout("mux", start, size, 1, 0, first, last, "1", comment), "M", "None")


def inputs(k: int) -> Iterator[Message]:
    """Make what the battery management system sends of string k."""
    yield Message(
        f"string_{k}_electrical",
        0x10 + k,
        BMS,
        100,
        f"Current and voltage of string {k}.",
        [
            *protection(),
            Signal(
                SignalLayout(
                    "current", 16, 24, 0.001, -8000, -8000, 8000, "A", "String current, positive on discharge."
                )
            ),
            Signal(SignalLayout("voltage", 40, 24, 0.0001, 0, 0, 1500, "V", "Voltage over all cells of the string.")),
        ],
    )
    yield Message(
        f"string_{k}_coolant",
        0x20 + k,
        BMS,
        1000,
        f"Coolant at the inlet of string {k}, and its state of charge.",
        [
            *protection(),
            Signal(celsius("coolant_inlet", 16, "Coolant temperature where it reaches the first cell.")),
            Signal(
                SignalLayout(
                    "coolant_flow", 32, 16, 1e-6, 0, 0, 0.064, "m3/s", "Coolant volume flow through the string."
                )
            ),
            Signal(SignalLayout("soc", 48, 16, 0.00002, 0, 0, 1, "1", "State of charge, 0 empty, 1 full.")),
        ],
    )
    groups = range(CELLS // PER_FRAME)
    surface = Message(
        f"string_{k}_surface", 0x30 + k, BMS, 1000, f"Surface temperatures of the cells of string {k}, three per frame."
    )
    voltage = Message(
        f"string_{k}_cell_voltage", 0x40 + k, BMS, 1000, f"Voltages of the cells of string {k}, three per frame."
    )
    for message, noun in ((surface, "Surface temperatures"), (voltage, "Voltages")):
        note = f"{noun} of cells 3 mux + 1 to 3 mux + 3; values of cells that do not exist are not available."
        message.signals += [*protection(), selector(12, 4, groups[-1], note)]
    for g in groups:
        for i in range(PER_FRAME):
            cell = PER_FRAME * g + i + 1
            start = 16 + 16 * i
            where = f"Surface temperature of cell {cell}."
            surface.signals.append(Signal(celsius(f"surface_{cell:02d}", start, where), g))
            across = f"Voltage of cell {cell}."
            volts = SignalLayout(f"cell_voltage_{cell:02d}", start, 16, 0.0001, 0, 0, 6, "V", across)
            voltage.signals.append(Signal(volts, g))
    yield surface
    yield voltage


def output(message: SentMessage[Any], name: str, string: int = 0) -> Message:
    """Make one message of the table of what the gateway sends."""
    made = Message(name, message.group + string, GATEWAY, message.cycle_ms, message.comment.format(k=string))
    made.signals += protection()
    if message.of_cells:
        made.signals.append(selector(*message.mux[:2], CELLS, message.mux[2], first=1))
        made.signals += [cell_signal(s, c) for c in range(1, CELLS + 1) for s in message.parts[0].signals]
    elif message.mux is not None:
        made.signals.append(selector(*message.mux[:2], len(message.parts) - 1, message.mux[2]))
        made.signals += [Signal(s, m) for m, part in enumerate(message.parts) for s in part.signals]
    else:
        made.signals += [Signal(s) for s in message.parts[0].signals]
    return made


def cell_signal(of: SignalLayout, c: int) -> Signal:
    """Make the signal of one cell."""
    return Signal(of._replace(name=of.name.format(c=c), comment=of.comment.format(c=c)), c)


def messages() -> list[Message]:
    """All messages: inputs, then outputs, string by string, then those of the gateway itself."""
    strings = range(1, STRINGS + 1)
    return [
        *(m for k in strings for m in inputs(k)),
        *(output(m, string_message(k, m.name), k) for k in strings for m in STRING_MESSAGES),
        *(output(m, m.name) for m in GATEWAY_MESSAGES),
    ]


def number(x: float) -> str:
    """Shortest decimal, never in scientific notation: some tools cannot read that."""
    return f"{x:.8f}".rstrip("0").rstrip(".")


def signal_line(s: Signal, receiver: str) -> str:
    """SG_ line."""
    mux = "" if s.mux is None else " M" if s.mux == "M" else f" m{s.mux}"
    x = s.layout
    return (
        f" SG_ {x.name}{mux} : {x.start}|{x.size}@1+ ({number(x.scale)},{number(x.offset)})"
        f' [{number(x.low)}|{number(x.high)}] "{x.unit}" {receiver}'
    )


ATTRIBUTES = f"""\
BA_DEF_ BU_ "NmStationAddress" INT 0 255;
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_ BO_ "E2EProfile" ENUM "None","{E2E_PROFILE}";
BA_DEF_ BO_ "E2EDataID" INT 0 65535;
BA_DEF_ SG_ "GenSigStartValue" FLOAT 0 16777215;
BA_DEF_ SG_ "RawConvention" ENUM "None","J1939";
BA_DEF_ "BusType" STRING;
BA_DEF_ "ProtocolType" STRING;
BA_DEF_DEF_ "NmStationAddress" 254;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
BA_DEF_DEF_ "E2EProfile" "None";
BA_DEF_DEF_ "E2EDataID" 0;
BA_DEF_DEF_ "GenSigStartValue" 0;
BA_DEF_DEF_ "RawConvention" "J1939";
BA_DEF_DEF_ "BusType" "CAN";
BA_DEF_DEF_ "ProtocolType" "J1939";"""

ABOUT = (
    "Thermal estimates of battery strings. 29-bit identifiers of J1939 proprietary B parameter groups. Signals whose "
    "attribute RawConvention is J1939 are not available at all ones (raw 0xFF.., 0xF for 4 bits) and in error at "
    "0xFE.. (0xE); receivers must test that before scaling. Messages with the E2EProfile AUTOSAR_P01_1A carry "
    "a CRC in byte 0 and a counter in the low half of byte 1 by AUTOSAR E2E profile 1 variant 1A; E2EDataID is the "
    "parameter group number. In multiplexed messages every multiplexer value has a counter of its own."
)


def dbc() -> str:
    """Write the whole file as text."""
    everything = messages()
    lines = ['VERSION "1.0"', "", "NS_ :", "", "BS_:", "", f"BU_: {GATEWAY} {BMS}"]
    for name, table in VALUE_TABLES.items():
        lines.append(f"VAL_TABLE_ {name} {labels(table)} ;")
    for m in everything:
        lines += ["", f"BO_ {m.frame_id} {m.name}: 8 {m.sender}"]
        lines += [signal_line(s, m.receiver) for s in m.signals]
    lines += ["", f'CM_ "{ABOUT}";']
    lines.append(f'CM_ BU_ {GATEWAY} "This gateway: estimates core temperatures from what {BMS} sends.";')
    lines.append(f'CM_ BU_ {BMS} "The battery management system: measures current, voltage and surface temperatures.";')
    for m in everything:
        lines.append(f'CM_ BO_ {m.frame_id} "{m.comment}";')
        lines += [f'CM_ SG_ {m.frame_id} {s.name} "{s.layout.comment}";' for s in m.signals]
    lines += ATTRIBUTES.splitlines()
    lines.append(f'BA_ "NmStationAddress" BU_ {GATEWAY} {GATEWAY_ADDRESS};')
    lines.append(f'BA_ "NmStationAddress" BU_ {BMS} {BMS_ADDRESS};')
    for m in everything:
        lines.append(f'BA_ "GenMsgCycleTime" BO_ {m.frame_id} {m.cycle_ms};')
        lines.append(f'BA_ "E2EProfile" BO_ {m.frame_id} 1;')
        lines.append(f'BA_ "E2EDataID" BO_ {m.frame_id} {m.data_id};')
        for s in m.signals:
            lines.append(f'BA_ "GenSigStartValue" SG_ {m.frame_id} {s.name} {s.start_raw};')
            if s.convention != "J1939":
                lines.append(f'BA_ "RawConvention" SG_ {m.frame_id} {s.name} 0;')
    for m in everything:
        lines += [
            f"VAL_ {m.frame_id} {s.name} {labels(VALUE_TABLES[s.layout.table])} ;" for s in m.signals if s.layout.table
        ]
    return "\n".join(lines) + "\n"


def labels(table: Mapping[int, str]) -> str:
    """Entries of a value table."""
    return " ".join(f'{raw} "{label}"' for raw, label in table.items())


TARGET = Path(__file__).with_name("bms_gateway.dbc")

if __name__ == "__main__":
    TARGET.write_text(dbc(), encoding="ascii")
