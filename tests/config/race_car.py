"""Config of a real car: one current, 141 thermistors behind an 8-bit multiplexer, 29-bit identifiers, its own DBC."""

from pathlib import Path

from tests.data import need

THERMISTORS = 141
PER_STRING = 18

MODEL = """\
cells = {cells}
sensors = {sensors}
condition = "natural"
effects = []

[cell]
capacity_Ah = 4.0

[parameters]                     # a pouch cell of some 70 g in still air
C_c  = {{ value = 60.0, unit = "J/K", rel_sd = 0.2 }}
C_s  = {{ value = 8.0, unit = "J/K", rel_sd = 0.2 }}
R_e  = {{ value = 10.0, unit = "mOhm", rel_sd = 0.5 }}
R_c  = {{ value = 2.0, unit = "K/W", rel_sd = 0.5 }}
R_u  = {{ value = 8.0, unit = "K/W", rel_sd = 0.5 }}
R_cc = {{ value = 5.0, unit = "K/W", rel_sd = 0.5 }}
"""


def write_race_car(folder: Path, *, transmit: bool = True, inlet_C: float = 22.0, method: str = "window") -> Path:
    """Write gateway.toml and its models into a folder; skips the test where the DBC is absent.

    Eight strings of up to 18 cells, every cell with its thermistor; returns the path of the config.
    """
    dbc = need("dbc", "uwfe_2024CAR_fixed.dbc")
    lines = [
        "[bus]",
        'channel = "vcan0"',
        f"dbc = [{str(dbc)!r}]",
        f"transmit = {str(transmit).lower()}",
        "[identify]",
        f'method = "{method}"',
    ]
    channels = list(range(1, THERMISTORS + 1))
    for number, first in enumerate(range(0, THERMISTORS, PER_STRING), 1):
        mine = channels[first : first + PER_STRING]
        cells = len(mine)
        model = folder / f"module_{cells}.toml"
        model.write_text(MODEL.format(cells=cells, sensors=list(range(1, cells + 1))))
        lines += [
            "[[string]]",
            f'name = "module_{number}"',
            f'model = "{model.name}"',
            "[string.signals]",
            'current = "BMU_stateBusHV.CurrentBusHV"',
            f"coolant_inlet = {{ constant_C = {inlet_C} }}",
            "[string.signals.surface]",
            *(f'{k} = "BMU_ChannelTemp.TempChannel{c:02d}"' for k, c in enumerate(mine, 1)),
        ]
    config = folder / "gateway.toml"
    config.write_text("\n".join(lines) + "\n")
    return config
