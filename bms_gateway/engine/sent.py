"""The table of what our node sends: each signal is one row with its layout, its description and its value.

The DBC (`dbc/generate.py`), the encoder (`engine/broadcast.py`) and the tests follow from `STRING_MESSAGES` and
`GATEWAY_MESSAGES`. Functions of `engine/sent_values.py` read values that need more than a few words.
"""

from functools import partial
from math import nan
from operator import itemgetter
from typing import Final

import numpy as np

from bms_gateway.engine import sent_values as of
from bms_gateway.engine.sent_message import BY_CELL, Message, part
from bms_gateway.engine.string_estimator import StringEstimator
from bms_gateway.frames.own_dbc import GATEWAY_STATUS, MAX_CELLS
from bms_gateway.frames.own_layout import SignalLayout, band, cell, celsius, count, enumeration, percent, percent_sd

__all__ = ["GATEWAY_MESSAGES", "STRING_MESSAGES"]

HOTTEST: Final = (
    "Hottest point of string {k}: cores are means of a cell's roll, this is the hottest point within a cell."
)
CORE: Final = "core temperature of cell {c}"
GROWN: Final = "Growth of the internal resistance since commissioning."
HEAT: Final = "Heat of cell {c} that no current makes; not available where no sensor tells of it."
MISSES: Final = "Whether the model misses a physical effect or a sensor errs."
DRIFTED: Final = "Cell whose thermocouple has drifted, from 1; 0 where all have alike, as by the inlet's sensor."
FORECAST: Final = (
    "Next ten minutes of string {k} at the load of now, and the constant currents that keep every hottest point "
    "below its limit with two standard deviations to spare; renewed every ten seconds."
)
NEVER: Final = "Time until the first hottest point reaches its limit; 600 where that is not within ten minutes."
PERMITTED: Final = "Greatest constant {} current for {}; not available where cores are unknown."
POINT: Final = "Hottest point in {}, of the cell that will be hottest in ten minutes."
POINT_SD: Final = "Standard deviation of the hottest point in {}, of the cell that will be hottest in ten minutes."
FIRST: Final = "Cell that reaches its limit first, from 1; 0: none."
INNOVATION: Final = "Normalised innovation: 1 where the model fits its noise."
HORIZONS: Final = (("1min", "one minute"), ("5min", "five minutes"), ("10min", "ten minutes"))
DURATIONS: Final = (("10s", "10 s"), *HORIZONS[::2])

STRING_MESSAGES: Final[tuple[Message[StringEstimator], ...]] = (
    Message(
        "core",
        0x50,
        1000,
        "Core temperatures of string {k}, one cell per frame.",
        mux=BY_CELL,
        parts=(
            part(
                of.string,
                (
                    enumeration("quality_{c:02d}", 12, "Quality", f"How far the {CORE} rests on a sensor."),
                    lambda s: s.quality,
                ),
                (celsius("core_{c:02d}", 24, "Estimated core temperature of cell {c}."), lambda s: s.core),
                (celsius("surface_{c:02d}", 40, "Estimated surface temperature of cell {c}."), lambda s: s.surface),
                (band("core_sd_{c:02d}", 56, f"Standard deviation of the {CORE}."), lambda s: s.core_sd),
            ),
        ),
    ),
    Message(
        "summary",
        0x60,
        1000,
        "Hottest and coldest core of string {k}.",
        parts=(
            part(
                of.hottest_core,
                (
                    enumeration("hottest_quality", 12, "Quality", "Quality of the hottest core temperature."),
                    lambda h: h.read(h.string.quality),
                ),
                (celsius("hottest_core", 16, "Highest estimated core temperature."), lambda h: h.read(h.string.core)),
                (cell("hottest_cell", 32, "Cell with the hottest core, from 1."), lambda h: h.k + 1),
                (
                    band("hottest_sd", 40, "Standard deviation of the hottest core temperature."),
                    lambda h: h.read(h.string.core_sd),
                ),
                (
                    celsius("coldest_core", 48, "Lowest estimated core temperature."),
                    lambda h: float(np.fmin.reduce(h.string.core)),
                ),
            ),
        ),
    ),
    Message(
        "hottest",
        0xC0,
        1000,
        HOTTEST,
        parts=(
            part(
                of.hottest_point,
                (
                    enumeration("hottest_point_quality", 12, "Quality", "Quality of the hottest point."),
                    lambda h: h.read(h.string.quality),
                ),
                (
                    celsius("hottest_point", 16, "Estimated temperature of the string's hottest point."),
                    lambda h: h.read(h.string.centre),
                ),
                (cell("hottest_point_cell", 32, "Cell with the hottest point, from 1."), lambda h: h.k + 1),
                (
                    band("hottest_point_sd", 40, "Standard deviation of the hottest point."),
                    lambda h: h.read(h.string.centre_sd),
                ),
                (celsius("hottest_point_core", 48, "Core temperature of that cell."), lambda h: h.read(h.string.core)),
            ),
        ),
    ),
    Message(
        "parameters",
        0x70,
        10000,
        "Thermal parameters identified for string {k}.",
        mux=(16, 8, "0 R_e, 1 R_c, 2 R_u."),
        parts=(
            *(
                part(
                    partial(of.estimate, name),
                    (
                        enumeration(f"{name}_status", 12, "ParameterStatus", f"Whether {name} can be trusted."),
                        of.status_code,
                    ),
                    (
                        SignalLayout(name, 24, 24, scale, 0, 0, 0xFAFFFF * scale, unit, f"{noun}, mean of the cells."),
                        lambda e: of.in_unit(e, e.value),
                    ),
                    (
                        SignalLayout(f"{name}_sd", 48, 16, 0.001, 0, 0, 64, unit, f"Standard deviation of {name}."),
                        lambda e: of.in_unit(e, e.sd),
                    ),
                )
                for name, unit, scale, noun in (
                    ("R_e", "mOhm", 0.0001, "Internal resistance"),
                    ("R_c", "K/W", 0.00001, "Thermal resistance core to surface"),
                    ("R_u", "K/W", 0.00001, "Thermal resistance surface to coolant"),
                )
            ),
        ),
    ),
    Message(
        "health",
        0x80,
        10000,
        "Ageing and model fit of string {k}.",
        parts=(
            part(
                of.string,
                (enumeration("R_e_flag", 12, "Degradation", GROWN), lambda s: of.ageing_flag(s.ageing)),
                (percent("R_e_growth", 16, "Growth of R_e since commissioning."), lambda s: 100.0 * s.ageing.growth),
                (
                    percent_sd("R_e_growth_sd", 32, "Standard deviation of the growth."),
                    lambda s: 100.0 * s.ageing.growth_sd,
                ),
                (
                    SignalLayout("innovation", 48, 8, 0.1, 0, 0, 25, "1", INNOVATION),
                    lambda s: s.mismatch.excess**0.5,
                ),
                (enumeration("mismatch_flag", 56, "Mismatch", MISSES), lambda s: s.mismatch.flag.level),
            ),
        ),
    ),
    Message(
        "flags",
        0xA0,
        1000,
        "Flags of string {k}: what is wrong, cause by cause.",
        parts=(
            part(
                of.string,
                (enumeration("ageing_flag", 12, "Degradation", GROWN), lambda s: of.ageing_flag(s.health.ageing)),
                (
                    enumeration("cooling_flag", 16, "Fault", "Heat leaves the cells less well than at commissioning."),
                    lambda s: of.if_commissioned(s, s.health.cooling.flag),
                ),
                (
                    enumeration("thermocouple_flag", 20, "Fault", "A thermocouple or the inlet's sensor has drifted."),
                    lambda s: of.if_commissioned(s, s.health.drift.flag),
                ),
                (
                    enumeration("current_flag", 24, "Mismatch", "Heat or voltage contradict the current."),
                    lambda s: of.if_commissioned(s, s.health.current.flag),
                ),
                (enumeration("mismatch_flag", 28, "Mismatch", MISSES), lambda s: s.health.mismatch.flag.level),
                (
                    SignalLayout("thermocouple_cell", 32, 8, 1, 0, 0, 250, "1", DRIFTED),
                    lambda s: s.health.drift.worst if s.health.drift.flag.level else nan,
                ),
                (
                    percent("R_u_growth", 40, "Growth of R_u since commissioning."),
                    lambda s: 100.0 * s.health.cooling.growth,
                ),
                (
                    enumeration(
                        "runaway_flag", 56, "Fault", "Thermal runaway of a cell; stays until it is acknowledged."
                    ),
                    lambda s: of.ALARM * s.runaway,
                ),
                (
                    enumeration(
                        "hot_flag", 60, "Fault", "A core or surface is above its limit, or lost while it heated."
                    ),
                    lambda s: of.ALARM * s.hot,
                ),
            ),
        ),
    ),
    Message(
        "growth",
        0xB0,
        10000,
        "Ageing of the single cells of string {k}, one cell per frame.",
        mux=BY_CELL,
        parts=(
            part(
                of.growth_of_cells,
                (
                    enumeration("flag_{c:02d}", 12, "Degradation", "Growth of R_e of cell {c} since commissioning."),
                    lambda cells: np.array([of.ageing_flag(a) for a in cells]),
                ),
                (
                    percent("growth_{c:02d}", 24, "Growth of R_e of cell {c}."),
                    lambda cells: 100.0 * np.array([a.growth for a in cells]),
                ),
                (
                    percent_sd("growth_sd_{c:02d}", 40, "Standard deviation of the growth."),
                    lambda cells: 100.0 * np.array([a.growth_sd for a in cells]),
                ),
            ),
        ),
    ),
    Message(
        "heat",
        0xD0,
        1000,
        "Unexplained heat of the cells of string {k}, one cell per frame.",
        mux=BY_CELL,
        parts=(
            part(
                of.string,
                (enumeration("heat_flag_{c:02d}", 12, "Fault", "Whether cell {c} heats by itself."), of.heat_flags),
                (SignalLayout("heat_{c:02d}", 24, 16, 0.02, -320, -320, 965, "W", HEAT), lambda s: s.own_heat),
                (
                    SignalLayout("heat_sd_{c:02d}", 40, 16, 0.01, 0, 0, 640, "W", "Standard deviation of the heat."),
                    lambda s: s.own_heat_sd,
                ),
            ),
        ),
    ),
    Message(
        "forecast",
        0xE0,
        1000,
        FORECAST,
        mux=(12, 4, "0 temperatures, 1 uncertainty and limit, 2 discharge, 3 charge."),
        parts=(
            part(
                of.in_ten_minutes,
                *(
                    (
                        celsius(f"point_in_{name}", 16 * i, POINT.format(words)),
                        partial(of.point_ahead, i),
                    )
                    for i, (name, words) in enumerate(HORIZONS, 1)
                ),
            ),
            part(
                of.in_ten_minutes,
                *(
                    (
                        SignalLayout(f"point_sd_{name}", 8 + 8 * i, 8, 0.1, 0, 0, 25, "K", POINT_SD.format(words)),
                        partial(of.point_sd_ahead, i),
                    )
                    for i, (name, words) in enumerate(HORIZONS, 1)
                ),
                (
                    SignalLayout("limit_cell", 40, 8, 1, 0, 0, MAX_CELLS, "1", FIRST),
                    of.limit_cell,
                ),
                (SignalLayout("limit_in", 48, 16, 0.1, 0, 0, of.WITHIN_S, "s", NEVER), of.limit_in),
            ),
            *(
                part(
                    partial(of.permitted, way),
                    *(
                        (
                            SignalLayout(
                                f"{way}_{name}", 16 + 16 * i, 16, 0.1, 0, 0, 6400, "A", PERMITTED.format(way, words)
                            ),
                            itemgetter(i),
                        )
                        for i, (name, words) in enumerate(DURATIONS)
                    ),
                )
                for way in ("discharge", "charge")
            ),
        ),
    ),
)

GATEWAY_MESSAGES: Final[tuple[Message[of.Gateway], ...]] = (
    Message(
        GATEWAY_STATUS,
        0x90,
        1000,
        "State of the gateway.",
        parts=(
            part(
                of.Gateway.it,
                (enumeration("state", 12, "GatewayState", "What the gateway is doing."), lambda g: g.state.value),
                (
                    count("frame_rate", 16, "1/s", "Wanted frames received in the last second."),
                    lambda g: g.counts.frames,
                ),
                (
                    count("rejected_samples", 32, "1/s", "Samples not used in the last second."),
                    lambda g: g.counts.rejected,
                ),
                (
                    count("dropped_frames", 48, "1", "Frames lost to a full buffer since start."),
                    lambda g: g.counts.dropped,
                ),
            ),
        ),
    ),
    Message(
        "gateway_info",
        0x91,
        10000,
        "Software version and uptime.",
        parts=(
            part(
                of.Gateway.it,
                *(
                    (
                        SignalLayout(
                            f"version_{name}", 16 + 8 * i, 8, 1, 0, 0, 250, "1", f"Software version, {nth} number."
                        ),
                        partial(of.version, i),
                    )
                    for i, (name, nth) in enumerate((("major", "first"), ("minor", "second"), ("patch", "third")))
                ),
                (
                    SignalLayout("uptime", 40, 24, 1, 0, 0, 16000000, "s", "Time since the gateway started."),
                    lambda g: g.counts.uptime_s,
                ),
            ),
        ),
    ),
)
