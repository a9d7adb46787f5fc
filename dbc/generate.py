"""Write `bms_gateway.dbc`: the messages that the gateway reads by default and those that it sends.

Eight strings of up to 18 cells give about a thousand signals, too many to keep right by hand. Run
``python dbc/generate.py`` after a change here, then ``python dbc/tabulate.py``; tests fail while a file is out of date.
Standard library only.

Layout rules: little-endian; every message has eight bytes; AUTOSAR E2E profile 1 variant 1A takes byte 0 (CRC) and the
low half of byte 1 (counter); raw values from 0xFE in the top byte on are J1939's error and not-available ranges.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

STRINGS = 8
CELLS = 18
PER_FRAME = 3
"""Cells per multiplexer value: three 16-bit values are what six bytes hold."""

GATEWAY, BMS = "BMS_GATEWAY", "BMS"
GATEWAY_ADDRESS, BMS_ADDRESS = 0xA8, 0xA5
"""J1939 source addresses from the range 128…247 that is left to the network's designer."""
PRIORITY = 6
"""J1939's default for proprietary messages."""
E2E_PROFILE = "AUTOSAR_P01_1A"

KELVIN = -273.15
VALUE_TABLES: dict[str, dict[int, str]] = {
    "Quality": {
        0: "good",
        1: "stale",
        2: "out of range",
        3: "not sent",
        4: "sensor failed",
        5: "stuck",
        6: "open",
        7: "short",
        8: "jumpy",
        9: "counter",
        10: "crc",
        11: "estimated",
        12: "doubtful",
        13: "reserved 13",
        14: "error",
        15: "not available",
    },
    "ParameterStatus": {
        0: "learning",
        1: "identified",
        2: "not identifiable",
        3: "fixed",
        14: "error",
        15: "not available",
    },
    "Degradation": {0: "none", 1: "watch", 2: "warning", 3: "alarm", 14: "error", 15: "not available"},
    "Fault": {0: "none", 1: "warning", 2: "alarm", 14: "error", 15: "not available"},
    "Mismatch": {0: "none", 1: "suspected", 2: "confirmed", 14: "error", 15: "not available"},
    "GatewayState": {
        0: "starting",
        1: "running",
        2: "degraded",
        3: "bus silent",
        4: "stopping",
        14: "error",
        15: "not available",
    },
}


@dataclass
class Signal:
    """One signal; `mux` is None outside the multiplexer, "M" for the multiplexer itself, else its value."""

    name: str
    start: int
    size: int
    scale: float
    offset: float
    low: float
    high: float
    unit: str
    comment: str
    mux: int | str | None = None
    table: str | None = None
    convention: str = "J1939"

    @property
    def start_raw(self) -> int:
        """Not available until something is known; counters, check sums and multiplexers begin at zero."""
        return (1 << self.size) - 1 if self.convention == "J1939" else 0


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
        Signal("crc", 0, 8, 1, 0, 0, 255, "1", crc, convention="None"),
        Signal("counter", 8, 4, 1, 0, 0, 14, "1", counter, convention="None"),
    ]


def selector(start: int, size: int, last: int, comment: str, first: int = 0) -> Signal:
    """Build the multiplexer."""
    return Signal("mux", start, size, 1, 0, first, last, "1", comment, mux="M", convention="None")


def celsius(name: str, start: int, comment: str, mux: int | None = None) -> Signal:
    """Temperature, 0.01 K from absolute zero on; more than 300 °C is no temperature of a cell that still exists."""
    return Signal(name, start, 16, 0.01, KELVIN, KELVIN, 300, "degC", comment, mux=mux)


def enumeration(name: str, start: int, table: str, comment: str, mux: int | None = None) -> Signal:
    """Four bits with a value table; 14 and 15 are J1939's error and not available."""
    last = max(raw for raw in VALUE_TABLES[table] if raw < 14)
    return Signal(name, start, 4, 1, 0, 0, last, "1", comment, mux=mux, table=table)


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
            Signal("current", 16, 24, 0.001, -8000, -8000, 8000, "A", "String current, positive on discharge."),
            Signal("voltage", 40, 24, 0.0001, 0, 0, 1500, "V", "Voltage over all cells of the string."),
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
            celsius("coolant_inlet", 16, "Coolant temperature where it reaches the first cell."),
            Signal("coolant_flow", 32, 16, 1e-6, 0, 0, 0.064, "m3/s", "Coolant volume flow through the string."),
            Signal("soc", 48, 16, 0.00002, 0, 0, 1, "1", "State of charge, 0 empty, 1 full."),
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
            surface.signals.append(celsius(f"surface_{cell:02d}", start, where, g))
            across = f"Voltage of cell {cell}."
            voltage.signals.append(Signal(f"cell_voltage_{cell:02d}", start, 16, 0.0001, 0, 0, 6, "V", across, mux=g))
    yield surface
    yield voltage


def outputs(k: int) -> Iterator[Message]:
    """Make what the gateway tells of string k."""
    core = Message(f"string_{k}_core", 0x50 + k, GATEWAY, 1000, f"Core temperatures of string {k}, one cell per frame.")
    core.signals += [*protection(), selector(16, 8, CELLS, "Number of the cell, from 1.", first=1)]
    for c in range(1, CELLS + 1):
        sd = f"Standard deviation of the core temperature of cell {c}."
        core.signals += [
            enumeration(
                f"quality_{c:02d}", 12, "Quality", f"How far the core temperature of cell {c} rests on a sensor.", c
            ),
            celsius(f"core_{c:02d}", 24, f"Estimated core temperature of cell {c}.", c),
            celsius(f"surface_{c:02d}", 40, f"Estimated surface temperature of cell {c}.", c),
            Signal(f"core_sd_{c:02d}", 56, 8, 0.05, 0, 0, 12.5, "K", sd, mux=c),
        ]
    yield core
    yield Message(
        f"string_{k}_summary",
        0x60 + k,
        GATEWAY,
        1000,
        f"Hottest and coldest core of string {k}.",
        [
            *protection(),
            enumeration("hottest_quality", 12, "Quality", "Quality of the hottest core temperature."),
            celsius("hottest_core", 16, "Highest estimated core temperature."),
            Signal("hottest_cell", 32, 8, 1, 0, 1, CELLS, "1", "Cell with the hottest core, from 1."),
            Signal("hottest_sd", 40, 8, 0.05, 0, 0, 12.5, "K", "Standard deviation of the hottest core temperature."),
            celsius("coldest_core", 48, "Lowest estimated core temperature."),
        ],
    )
    parameters = Message(
        f"string_{k}_parameters", 0x70 + k, GATEWAY, 10000, f"Thermal parameters identified for string {k}."
    )
    parameters.signals += [*protection(), selector(16, 8, 2, "0 R_e, 1 R_c, 2 R_u.")]
    for m, (name, unit, scale, noun) in enumerate(
        (
            ("R_e", "mOhm", 0.0001, "Internal resistance"),
            ("R_c", "K/W", 0.00001, "Thermal resistance core to surface"),
            ("R_u", "K/W", 0.00001, "Thermal resistance surface to coolant"),
        )
    ):
        top = 0xFAFFFF * scale
        parameters.signals += [
            enumeration(f"{name}_status", 12, "ParameterStatus", f"Whether {name} can be trusted.", m),
            Signal(name, 24, 24, scale, 0, 0, top, unit, f"{noun}, mean of the cells.", mux=m),
            Signal(f"{name}_sd", 48, 16, 0.001, 0, 0, 64, unit, f"Standard deviation of {name}.", mux=m),
        ]
    yield parameters
    yield Message(
        f"string_{k}_health",
        0x80 + k,
        GATEWAY,
        10000,
        f"Ageing and model fit of string {k}.",
        [
            *protection(),
            enumeration("R_e_flag", 12, "Degradation", "Growth of the internal resistance since commissioning."),
            Signal("R_e_growth", 16, 16, 0.01, -100, -100, 500, "%", "Growth of R_e since commissioning."),
            Signal("R_e_growth_sd", 32, 16, 0.01, 0, 0, 600, "%", "Standard deviation of the growth."),
            Signal("innovation", 48, 8, 0.1, 0, 0, 25, "1", "Normalised innovation: 1 where the model fits its noise."),
            enumeration(
                "mismatch_flag", 56, "Mismatch", "Whether the model misses a physical effect or a sensor errs."
            ),
        ],
    )


def flags(k: int) -> Iterator[Message]:
    """Make what the gateway tells of the causes of trouble in string k, and of the ageing of its cells."""
    yield Message(
        f"string_{k}_flags",
        0xA0 + k,
        GATEWAY,
        1000,
        f"Flags of string {k}: what is wrong, cause by cause.",
        [
            *protection(),
            enumeration("ageing_flag", 12, "Degradation", "Growth of the internal resistance since commissioning."),
            enumeration("cooling_flag", 16, "Fault", "Heat leaves the cells less well than at commissioning."),
            enumeration("thermocouple_flag", 20, "Fault", "A thermocouple or the inlet's sensor has drifted."),
            enumeration("current_flag", 24, "Mismatch", "Heat or voltage contradict the current."),
            enumeration(
                "mismatch_flag", 28, "Mismatch", "Whether the model misses a physical effect or a sensor errs."
            ),
            Signal(
                *("thermocouple_cell", 32, 8, 1, 0, 0, 250, "1"),
                "Cell whose thermocouple has drifted, from 1; 0 where all have alike, as by the inlet's sensor.",
            ),
            Signal("R_u_growth", 40, 16, 0.01, -100, -100, 500, "%", "Growth of R_u since commissioning."),
            enumeration("runaway_flag", 56, "Fault", "Thermal runaway of a cell; stays until it is acknowledged."),
            enumeration("hot_flag", 60, "Fault", "A core or surface is above its limit, or lost while it heated."),
        ],
    )
    growth = Message(
        f"string_{k}_growth", 0xB0 + k, GATEWAY, 10000, f"Ageing of the single cells of string {k}, one cell per frame."
    )
    growth.signals += [*protection(), selector(16, 8, CELLS, "Number of the cell, from 1.", first=1)]
    for c in range(1, CELLS + 1):
        growth.signals += [
            enumeration(f"flag_{c:02d}", 12, "Degradation", f"Growth of R_e of cell {c} since commissioning.", c),
            Signal(f"growth_{c:02d}", 24, 16, 0.01, -100, -100, 500, "%", f"Growth of R_e of cell {c}.", mux=c),
            Signal(f"growth_sd_{c:02d}", 40, 16, 0.01, 0, 0, 600, "%", "Standard deviation of the growth.", mux=c),
        ]
    yield growth


def hottest(k: int) -> Iterator[Message]:
    """Make what the gateway tells of the hottest point of string k."""
    yield Message(
        f"string_{k}_hottest",
        0xC0 + k,
        GATEWAY,
        1000,
        f"Hottest point of string {k}: cores are means of a cell's roll, this is the hottest point within a cell.",
        [
            *protection(),
            enumeration("hottest_point_quality", 12, "Quality", "Quality of the hottest point."),
            celsius("hottest_point", 16, "Estimated temperature of the string's hottest point."),
            Signal("hottest_point_cell", 32, 8, 1, 0, 1, CELLS, "1", "Cell with the hottest point, from 1."),
            Signal("hottest_point_sd", 40, 8, 0.05, 0, 0, 12.5, "K", "Standard deviation of the hottest point."),
            celsius("hottest_point_core", 48, "Core temperature of that cell."),
        ],
    )


def unexplained(k: int) -> Iterator[Message]:
    """Make what the gateway tells of heat in string k that no current makes."""
    heat = Message(
        f"string_{k}_heat", 0xD0 + k, GATEWAY, 1000, f"Unexplained heat of the cells of string {k}, one cell per frame."
    )
    heat.signals += [*protection(), selector(16, 8, CELLS, "Number of the cell, from 1.", first=1)]
    for c in range(1, CELLS + 1):
        what = f"Heat of cell {c} that no current makes; not available where no sensor tells of it."
        heat.signals += [
            enumeration(f"heat_flag_{c:02d}", 12, "Fault", f"Whether cell {c} heats by itself.", c),
            Signal(f"heat_{c:02d}", 24, 16, 0.02, -320, -320, 965, "W", what, mux=c),
            Signal(f"heat_sd_{c:02d}", 40, 16, 0.01, 0, 0, 640, "W", "Standard deviation of the heat.", mux=c),
        ]
    yield heat


def forecast(k: int) -> Iterator[Message]:
    """Make what the gateway tells of the next ten minutes of string k, and of the current that it stands."""
    m = Message(
        f"string_{k}_forecast",
        0xE0 + k,
        GATEWAY,
        1000,
        f"Next ten minutes of string {k} at the load of now, and the constant currents that keep every hottest point "
        "below its limit with two standard deviations to spare; renewed every ten seconds.",
    )
    m.signals += [*protection(), selector(12, 4, 3, "0 temperatures, 1 uncertainty and limit, 2 discharge, 3 charge.")]
    for i, (part, words) in enumerate((("1min", "one minute"), ("5min", "five minutes"), ("10min", "ten minutes"))):
        place = f"in {words}, of the cell that will be hottest in ten minutes"
        deviation = f"Standard deviation of the hottest point {place}."
        m.signals += [
            celsius(f"point_in_{part}", 16 + 16 * i, f"Hottest point {place}.", 0),
            Signal(f"point_sd_{part}", 16 + 8 * i, 8, 0.1, 0, 0, 25, "K", deviation, mux=1),
        ]
    never = "Time until the first hottest point reaches its limit; 600 where that is not within ten minutes."
    first = "Cell that reaches its limit first, from 1; 0: none."
    m.signals += [
        Signal("limit_cell", 40, 8, 1, 0, 0, CELLS, "1", first, mux=1),
        Signal("limit_in", 48, 16, 0.1, 0, 0, 600, "s", never, mux=1),
    ]
    for mux, way in ((2, "discharge"), (3, "charge")):
        for i, (part, words) in enumerate((("10s", "10 s"), ("1min", "one minute"), ("10min", "ten minutes"))):
            what = f"Greatest constant {way} current for {words}; not available where cores are unknown."
            m.signals.append(Signal(f"{way}_{part}", 16 + 16 * i, 16, 0.1, 0, 0, 6400, "A", what, mux=mux))
    yield m


def status() -> Iterator[Message]:
    """Make what the gateway tells of itself."""
    yield Message(
        "gateway_status",
        0x90,
        GATEWAY,
        1000,
        "State of the gateway.",
        [
            *protection(),
            enumeration("state", 12, "GatewayState", "What the gateway is doing."),
            Signal("frame_rate", 16, 16, 1, 0, 0, 64000, "1/s", "Wanted frames received in the last second."),
            Signal("rejected_samples", 32, 16, 1, 0, 0, 64000, "1/s", "Samples not used in the last second."),
            Signal("dropped_frames", 48, 16, 1, 0, 0, 64000, "1", "Frames lost to a full buffer since start."),
        ],
    )
    yield Message(
        "gateway_info",
        0x91,
        GATEWAY,
        10000,
        "Software version and uptime.",
        [
            *protection(),
            Signal("version_major", 16, 8, 1, 0, 0, 250, "1", "Software version, first number."),
            Signal("version_minor", 24, 8, 1, 0, 0, 250, "1", "Software version, second number."),
            Signal("version_patch", 32, 8, 1, 0, 0, 250, "1", "Software version, third number."),
            Signal("uptime", 40, 24, 1, 0, 0, 16000000, "s", "Time since the gateway started."),
        ],
    )


def messages() -> list[Message]:
    """All messages: inputs, then outputs; what has come later, last."""
    strings = range(1, STRINGS + 1)
    return [
        *(m for k in strings for m in inputs(k)),
        *(m for k in strings for m in outputs(k)),
        *status(),
        *(m for k in strings for m in flags(k)),
        *(m for k in strings for m in hottest(k)),
        *(m for k in strings for m in unexplained(k)),
        *(m for k in strings for m in forecast(k)),
    ]


def number(x: float) -> str:
    """Shortest decimal, never in scientific notation: some tools cannot read that."""
    return f"{x:.8f}".rstrip("0").rstrip(".")


def signal_line(s: Signal, receiver: str) -> str:
    """SG_ line."""
    mux = "" if s.mux is None else " M" if s.mux == "M" else f" m{s.mux}"
    return (
        f" SG_ {s.name}{mux} : {s.start}|{s.size}@1+ ({number(s.scale)},{number(s.offset)})"
        f' [{number(s.low)}|{number(s.high)}] "{s.unit}" {receiver}'
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
        lines += [f'CM_ SG_ {m.frame_id} {s.name} "{s.comment}";' for s in m.signals]
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
        lines += [f"VAL_ {m.frame_id} {s.name} {labels(VALUE_TABLES[s.table])} ;" for s in m.signals if s.table]
    return "\n".join(lines) + "\n"


def labels(table: dict[int, str]) -> str:
    """Entries of a value table."""
    return " ".join(f'{raw} "{label}"' for raw, label in table.items())


TARGET = Path(__file__).with_name("bms_gateway.dbc")

if __name__ == "__main__":
    TARGET.write_text(dbc(), encoding="ascii")
