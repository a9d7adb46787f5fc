"""Vehicles of other makers: their DBC as it should be, as they hand it out, and a log of a drive.

The drive is simulated by Euler steps of two nodes per cell; frames are encoded by cantools.
"""

from dataclasses import dataclass, field
from pathlib import Path

import cantools
import numpy as np

CELLS, SERIES = 8, 96
SECONDS = 400


@dataclass
class Vehicle:
    """A maker's DBC, what he says of it, what is on the bus, and which signal is what.

    Attributes
    ----------
    dbc : str
        By which frames are made.
    told : list of (old, new)
        Where the DBC that is handed out is wrong.
    values : mapping of signal ("Message.Signal") to its values
        In the DBC's unit, one a sample.
    period : mapping of message to s
    truth : mapping of signal to (role, index)
    scale : mapping of role to the product's scale, where it must not be 1
    """

    name: str
    dbc: str
    values: dict[str, np.ndarray]
    period: dict[str, float]
    truth: dict[str, tuple[str, int | None]]
    told: list[tuple[str, str]] = field(default_factory=list)
    scale: dict[str, float] = field(default_factory=dict)
    overrides: dict[str, dict] = field(default_factory=dict)
    address: int = 0
    encoding: str = "utf-8"


@dataclass
class Drive:
    """What happened: discharge-positive A, V, °C at 10 Hz."""

    t: np.ndarray
    current: np.ndarray
    voltage: np.ndarray
    cell_voltage: np.ndarray
    surface: np.ndarray
    soc: np.ndarray
    inlet: np.ndarray


def drive(seed: int = 1, seconds: int = SECONDS, amps: float = 120.0) -> Drive:
    """A drive with regeneration, stops, and cells that get warm."""
    rng = np.random.default_rng(seed)
    n = seconds * 10
    t = np.arange(n) / 10
    level = np.repeat(rng.choice([0.0, 0.15, 0.4, 1.0, -0.35, 0.6], seconds // 8 + 1), 80)[:n]
    current = np.convolve(level * amps, np.ones(15) / 15, "same") + rng.normal(0, 0.3, n)
    soc = 0.8 - np.cumsum(current) * 0.1 / 3600 / 60
    R = 1.2e-3 * (1 + 0.05 * rng.normal(size=SERIES))
    cell_voltage = (3.3 + 0.9 * soc)[:, None] + 0.004 * rng.normal(size=SERIES) - current[:, None] * R
    inlet = 19.0 + 0.8 * np.sin(t / 90)
    core = np.full(CELLS, 22.0) + 0.3 * rng.normal(size=CELLS)
    skin, surface = core.copy(), np.empty((n, CELLS))
    for k in range(n):
        heat = current[k] ** 2 * 1.4e-3
        core += 0.1 * (heat - (core - skin) / 0.3) / 700
        skin += 0.1 * ((core - skin) / 0.3 - (skin - inlet[k]) / 0.8) / 60
        surface[k] = skin
    return Drive(t, current, cell_voltage.sum(axis=1), cell_voltage, surface, soc, inlet)


def write(vehicle: Vehicle, folder: Path, seed: int = 1) -> tuple[Path, Path]:
    """Write log and DBC; returns both."""
    database = cantools.database.load_string(vehicle.dbc, "dbc")
    frames = []
    rng = np.random.default_rng(seed)
    for message in database.messages:
        period = vehicle.period.get(message.name, 0.1)
        step = max(round(period * 10), 1)
        select = message.is_multiplexed()
        mux = next((s for s in message.signals if s.is_multiplexer), None)
        rows = range(0, SECONDS * 10, step)
        for count, k in enumerate(rows):
            ids = sorted({i for s in message.signals for i in (s.multiplexer_ids or ())})
            chosen = ids[count % len(ids)] if select else None
            data = {}
            for s in message.signals:
                if s.multiplexer_ids and chosen not in s.multiplexer_ids:
                    continue
                x = vehicle.values.get(f"{message.name}.{s.name}")
                raw = float(count % 16) if x is None else float(x[k])
                data[s.name] = chosen if s is mux else raw
            payload = message.encode(data, strict=False, scaling=True)
            can_id = message.frame_id ^ vehicle.address
            text = f"{can_id:08X}" if message.is_extended_frame else f"{can_id:03X}"
            stamp = 1_700_000_000 + k / 10 + rng.uniform(0, 0.01)
            frames.append((stamp, f"({stamp:.6f}) can0 {text}#{payload.hex().upper()}\n"))
    frames.sort(key=lambda f: f[0])
    log, dbc = folder / f"{vehicle.name}.log", folder / f"{vehicle.name}.dbc"
    log.write_text("".join(line for _, line in frames))
    told = vehicle.dbc
    for old, new in vehicle.told:
        assert old in told, old
        told = told.replace(old, new)
    dbc.write_text(told, encoding=vehicle.encoding)
    return log, dbc


def _noise(n: int, seed: int, size: float) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, size, n)


def german() -> Vehicle:
    """Motorola order, an offset in the current, temperatures behind a multiplexer, names in German."""
    d, n = drive(2), SECONDS * 10
    lines = ['VERSION ""', "BU_: BMS"]
    lines += ["BO_ 288 HVB_Status1: 8 BMS",
              ' SG_ HVB_Strom_Ist : 7|16@0+ (0.1,-1638.4) [-1638.4|4915] "A" BMS',
              ' SG_ HVB_Spannung_Ist : 23|16@0+ (0.1,0) [0|1000] "V" BMS',
              ' SG_ HVB_Ladezustand : 39|10@0+ (0.1,0) [0|100] "%" BMS',
              ' SG_ HVB_Zaehler : 59|4@0+ (1,0) [0|15] "" BMS']  # fmt: skip
    lines += ["BO_ 289 HVB_Grenzen: 8 BMS",
              ' SG_ HVB_Strom_Limit_Entladen : 7|16@0+ (0.1,0) [0|2000] "A" BMS',
              ' SG_ HVB_Spannung_Max : 23|16@0+ (0.1,0) [0|1000] "V" BMS']  # fmt: skip
    lines += ["BO_ 290 HVB_Zelltemperaturen: 8 BMS", ' SG_ HVB_Zelltemp_Mux M : 7|8@0+ (1,0) [0|3] "" BMS']
    for k in range(CELLS):
        start = 15 + 8 * (k % 2)
        lines.append(f' SG_ HVB_Zelltemp_{k + 1:02d} m{k // 2} : {start}|8@0+ (0.5,-40) [-40|80] "°C" BMS')
    lines += ["BO_ 291 Kuehlung: 8 BMS", ' SG_ Kuehlmittel_Vorlauf_Temp : 7|8@0+ (0.5,-40) [-40|87] "°C" BMS',
              ' SG_ Aussentemp : 15|8@0+ (0.5,-40) [-40|87] "°C" BMS',
              ' SG_ Motor_Temp : 23|8@0+ (1,-40) [-40|210] "°C" BMS']  # fmt: skip
    v = {
        "HVB_Status1.HVB_Strom_Ist": d.current,
        "HVB_Status1.HVB_Spannung_Ist": d.voltage,
        "HVB_Status1.HVB_Ladezustand": 100 * d.soc,
        "HVB_Grenzen.HVB_Strom_Limit_Entladen": np.full(n, 350.0),
        "HVB_Grenzen.HVB_Spannung_Max": np.full(n, 403.0),
        "Kuehlung.Kuehlmittel_Vorlauf_Temp": d.inlet,
        "Kuehlung.Aussentemp": np.full(n, 12.0),
        "Kuehlung.Motor_Temp": 40 + d.t / 20,
    }
    v |= {f"HVB_Zelltemperaturen.HVB_Zelltemp_{k + 1:02d}": d.surface[:, k] for k in range(CELLS)}
    truth = {
        "HVB_Status1.HVB_Strom_Ist": ("current", None),
        "HVB_Status1.HVB_Spannung_Ist": ("voltage", None),
        "HVB_Status1.HVB_Ladezustand": ("soc", None),
        "Kuehlung.Kuehlmittel_Vorlauf_Temp": ("coolant_inlet", None),
    } | {f"HVB_Zelltemperaturen.HVB_Zelltemp_{k + 1:02d}": ("surface", k + 1) for k in range(CELLS)}
    period = {"HVB_Grenzen": 1.0, "HVB_Zelltemperaturen": 0.2, "Kuehlung": 1.0}
    return Vehicle("german", "\n".join(lines), v, period, truth)


def imperial() -> Vehicle:
    """°F, mA and mV; charge counts positive; several currents that are not the pack's; one thermistor is off."""
    d, n = drive(3), SECONDS * 10
    lines = ['VERSION ""', "BU_: B"]
    lines += ["BO_ 2566844672 BatteryElectrical: 8 B",
              ' SG_ PackCurrent : 0|32@1- (1,0) [-800000|800000] "mA" B',
              ' SG_ PackVoltage : 32|32@1+ (1,0) [0|900000] "mV" B',
              "BO_ 2566844673 DriveUnit: 8 B",
              ' SG_ MotorCurrentRms : 0|16@1+ (0.1,0) [0|1000] "A" B',
              ' SG_ InverterDcCurrent : 16|16@1- (0.1,0) [-1000|1000] "A" B',
              ' SG_ MaxDischargeCurrent : 32|16@1+ (0.1,0) [0|1000] "A" B',
              ' SG_ InverterTemp : 48|16@1- (0.1,0) [-40|300] "degF" B',
              "BO_ 2566844674 Accessories: 8 B",
              ' SG_ DcdcOutputCurrent : 0|16@1- (0.1,0) [-300|300] "A" B',
              ' SG_ AuxBatteryVoltage : 16|16@1+ (1,0) [0|20000] "mV" B',
              ' SG_ AmbientTemp : 32|16@1- (0.1,0) [-60|200] "degF" B',
              ' SG_ StateOfCharge : 48|8@1+ (0.5,0) [0|100] "%" B']  # fmt: skip
    for m in range(2):
        lines.append(f"BO_ {2566844680 + m} ModuleTemps{m + 1}: 8 B")
        lines += [f' SG_ Thermistor{4 * m + j + 1} : {16 * j}|16@1- (0.1,0) [-60|300] "degF" B' for j in range(4)]
    F = 1.8 * d.surface + 32
    v = {
        "BatteryElectrical.PackCurrent": -1000 * d.current,
        "BatteryElectrical.PackVoltage": 1000 * d.voltage,
        "DriveUnit.MotorCurrentRms": np.abs(1.4 * d.current + _noise(n, 4, 2.0)),
        "DriveUnit.InverterDcCurrent": 0.9 * d.current + 5 * np.sin(d.t) + _noise(n, 1, 4.0),
        "DriveUnit.MaxDischargeCurrent": np.full(n, 400.0),
        "DriveUnit.InverterTemp": 120 + d.t / 30,
        "Accessories.DcdcOutputCurrent": 12 + _noise(n, 2, 1.5),
        "Accessories.AuxBatteryVoltage": 13800 + _noise(n, 3, 20.0),
        "Accessories.AmbientTemp": np.full(n, 66.0),
        "Accessories.StateOfCharge": 100 * d.soc,
    }
    v |= {f"ModuleTemps{k // 4 + 1}.Thermistor{k + 1}": F[:, k] for k in range(CELLS)}
    v["ModuleTemps2.Thermistor7"] = np.full(n, -40.0)
    truth = {
        "BatteryElectrical.PackCurrent": ("current", None),
        "BatteryElectrical.PackVoltage": ("voltage", None),
        "Accessories.StateOfCharge": ("soc", None),
    } | {f"ModuleTemps{k // 4 + 1}.Thermistor{k + 1}": ("surface", None) for k in range(CELLS) if k != 6}
    period = {"ModuleTemps1": 0.5, "ModuleTemps2": 0.5, "Accessories": 1.0}
    return Vehicle("imperial", "\n".join(lines), v, period, truth, scale={"current": -1.0})


def wrong_dbc() -> Vehicle:
    """A DBC that is wrong: the current unsigned, a range too narrow, temperatures in the other byte order, in K."""
    d = drive(4)
    lines = ['VERSION ""', "BU_: B", "BO_ 512 PACK_MEAS: 8 B",
             ' SG_ pack_curr : 0|16@1- (0.05,0) [-1000|1000] "A" B',
             ' SG_ pack_volt : 16|16@1+ (0.05,0) [0|1000] "V" B',
             ' SG_ pack_soc : 32|16@1+ (0.01,0) [0|100] "%" B',
             ' SG_ alive : 56|4@1+ (1,0) [0|15] "" B']  # fmt: skip
    for m in range(2):
        lines.append(f"BO_ {520 + m} CELL_TEMP_{m}: 8 B")
        lines += [f' SG_ cell_temp_{4 * m + j} : {7 + 16 * j}|16@0+ (0.1,0) [0|400] "K" B' for j in range(4)]
    for m in range(SERIES // 4):
        lines.append(f"BO_ {600 + m} CELL_V_{m:02d}: 8 B")
        lines += [f' SG_ cell_v_{4 * m + j:02d} : {16 * j}|16@1+ (0.0001,0) [0|6.5535] "V" B' for j in range(4)]
    v = {"PACK_MEAS.pack_curr": d.current, "PACK_MEAS.pack_volt": d.voltage, "PACK_MEAS.pack_soc": 100 * d.soc}
    v |= {f"CELL_TEMP_{k // 4}.cell_temp_{k}": d.surface[:, k] + 273.15 for k in range(CELLS)}
    v |= {f"CELL_V_{k // 4:02d}.cell_v_{k:02d}": d.cell_voltage[:, k] for k in range(SERIES)}
    truth = {
        "PACK_MEAS.pack_curr": ("current", None),
        "PACK_MEAS.pack_volt": ("voltage", None),
        "PACK_MEAS.pack_soc": ("soc", None),
    }
    truth |= {f"CELL_TEMP_{k // 4}.cell_temp_{k}": ("surface", k + 1) for k in range(CELLS)}
    truth |= {f"CELL_V_{k // 4:02d}.cell_v_{k:02d}": ("cell_voltage", None) for k in range(SERIES)}
    told = [("0|16@1- (0.05,0) [-1000|1000]", "0|16@1+ (0.05,0) [0|1000]"), ("[0|100]", "[0|50]")]
    told += [(f"{7 + 16 * j}|16@0+ (0.1,0) [0|400]", f"{16 * j}|16@1+ (0.1,0) [0|400]") for j in range(4)]
    overrides = {"PACK_MEAS.pack_curr": {"signed": True}, "CELL_TEMP_0.cell_temp_0": {"byte_order": "big_endian"}}
    period = {f"CELL_V_{m:02d}": 1.0 for m in range(SERIES // 4)} | {"CELL_TEMP_0": 1.0, "CELL_TEMP_1": 1.0}
    return Vehicle("wrong_dbc", "\n".join(lines), v, period, truth, told, overrides=overrides)


def terse() -> Vehicle:
    """Names of one letter and no units at all; the current in 10 mA, the cells' voltages in mV."""
    d = drive(5)
    lines = ['VERSION ""', "BU_: B", "BO_ 256 BMS_1: 8 B",
             ' SG_ I_Batt : 7|16@0- (0.01,0) [0|0] "" B', ' SG_ U_Batt : 23|16@0+ (0.1,0) [0|0] "" B',
             ' SG_ SOC : 39|8@0+ (0.5,0) [0|0] "" B', ' SG_ Cnt : 47|8@0+ (1,0) [0|0] "" B',
             "BO_ 257 BMS_2: 8 B"]  # fmt: skip
    lines += [f' SG_ T{k + 1} : {8 * k}|8@1+ (1,-40) [0|0] "" B' for k in range(CELLS)]
    for m in range(2):
        lines.append(f"BO_ {260 + m} BMS_{3 + m}: 8 B")
        lines += [f' SG_ Uz{4 * m + j + 1} : {16 * j}|16@1+ (1,0) [0|0] "" B' for j in range(4)]
    v = {"BMS_1.I_Batt": d.current / 4, "BMS_1.U_Batt": d.cell_voltage[:, :8].sum(axis=1), "BMS_1.SOC": 100 * d.soc}
    v |= {f"BMS_2.T{k + 1}": d.surface[:, k] for k in range(CELLS)}
    v |= {f"BMS_{3 + k // 4}.Uz{k + 1}": 1000 * d.cell_voltage[:, k] for k in range(CELLS)}
    truth = {"BMS_1.I_Batt": ("current", None), "BMS_1.U_Batt": ("voltage", None), "BMS_1.SOC": ("soc", None)}
    truth |= {f"BMS_2.T{k + 1}": ("surface", k + 1) for k in range(CELLS)}
    truth |= {f"BMS_{3 + k // 4}.Uz{k + 1}": ("cell_voltage", k + 1) for k in range(CELLS)}
    return Vehicle("terse", "\n".join(lines), v, {"BMS_2": 1.0, "BMS_3": 0.5, "BMS_4": 0.5}, truth)


def truck() -> Vehicle:
    """J1939: another source address than in the DBC; one reading of all cells, the greatest, beside least and mean."""
    d, n = drive(6), SECONDS * 10
    lines = ['VERSION ""', "BU_: B",
             f"BO_ {0x80000000 | 0x18F1D0F3} HVESS_Data: 8 B",
             ' SG_ HVESS_VoltageLevel : 0|16@1+ (0.05,0) [0|3212.75] "V" B',
             ' SG_ HVESS_Current : 16|16@1+ (0.05,-1600) [-1600|1612.75] "A" B',
             ' SG_ HVESS_SOC : 32|16@1+ (0.0015625,0) [0|100] "%" B',
             f"BO_ {0x80000000 | 0x18F1D2F3} HVESS_Temps: 8 B",
             ' SG_ HVESS_HighestCellTemp : 0|16@1+ (0.03125,-273) [-273|1735] "degC" B',
             ' SG_ HVESS_LowestCellTemp : 16|16@1+ (0.03125,-273) [-273|1735] "degC" B',
             ' SG_ HVESS_AverageCellTemp : 32|16@1+ (0.03125,-273) [-273|1735] "degC" B',
             ' SG_ HVESS_CoolantInletTemp : 48|8@1+ (1,-40) [-40|210] "degC" B',
             'BA_DEF_ "ProtocolType" STRING ;', 'BA_DEF_DEF_ "ProtocolType" "";', 'BA_ "ProtocolType" "J1939";',
             'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";',
             'BA_DEF_DEF_ "VFrameFormat" "J1939PG";']  # fmt: skip
    v = {
        "HVESS_Data.HVESS_VoltageLevel": d.voltage,
        "HVESS_Data.HVESS_Current": d.current,
        "HVESS_Data.HVESS_SOC": 100 * d.soc,
        "HVESS_Temps.HVESS_HighestCellTemp": d.surface.max(axis=1),
        "HVESS_Temps.HVESS_LowestCellTemp": d.surface.min(axis=1),
        "HVESS_Temps.HVESS_AverageCellTemp": d.surface.mean(axis=1),
        "HVESS_Temps.HVESS_CoolantInletTemp": d.inlet,
    }
    v["HVESS_Temps.HVESS_LowestCellTemp"][: n // 50] = np.nan_to_num(0.0)
    truth = {
        "HVESS_Data.HVESS_Current": ("current", None),
        "HVESS_Data.HVESS_VoltageLevel": ("voltage", None),
        "HVESS_Data.HVESS_SOC": ("soc", None),
        "HVESS_Temps.HVESS_CoolantInletTemp": ("coolant_inlet", None),
    }
    truth |= {f"HVESS_Temps.HVESS_{which}CellTemp": ("surface", None) for which in ("Highest", "Average")}
    return Vehicle("truck", "\n".join(lines), v, {"HVESS_Temps": 1.0}, truth, address=0xF3 ^ 0x56)


VEHICLES = {f.__name__: f for f in (german, imperial, wrong_dbc, terse, truck)}


def parallel(names: tuple[str, str] = ("String1", "String2"), total: float | None = None) -> Vehicle:
    """Two strings of 12 cells that share unequally, with current, voltage, charge and thermocouples each.

    Parameters
    ----------
    names : pair of str
        By which the strings' signals and messages are told apart.
    total : float or None
        Pack current over the sum of the strings'; None where the bus has none.
    """
    d = drive(7)
    lines, v, truth = ['VERSION ""', "BU_: B"], {}, {}
    for k, (name, share) in enumerate(zip(names, (0.65, 0.35), strict=True)):
        lines += [f"BO_ {256 + 16 * k} {name}_Elec: 8 B",
                  f' SG_ {name}_Current : 0|16@1- (0.1,0) [-1000|1000] "A" B',
                  f' SG_ {name}_Voltage : 16|16@1+ (0.01,0) [0|600] "V" B',
                  f' SG_ {name}_SOC : 32|16@1+ (0.01,0) [0|100] "%" B',
                  f"BO_ {257 + 16 * k} {name}_Temps: 8 B"]  # fmt: skip
        lines += [f' SG_ {name}_CellTemp{j + 1} : {16 * j}|16@1- (0.1,0) [-40|120] "Cel" B' for j in range(4)]
        said = (share * d.current, d.cell_voltage[:, 12 * k : 12 * k + 12].sum(axis=1), 100 * d.soc)
        for role, what, x in zip(("current", "voltage", "soc"), ("Current", "Voltage", "SOC"), said, strict=True):
            v[f"{name}_Elec.{name}_{what}"] = x
            truth[f"{name}_Elec.{name}_{what}"] = (role, None)
        for j in range(4):
            v[f"{name}_Temps.{name}_CellTemp{j + 1}"] = d.surface[:, 4 * k + j]
            truth[f"{name}_Temps.{name}_CellTemp{j + 1}"] = ("surface", j + 1)
    if total is not None:
        lines += ["BO_ 400 Pack: 8 B", ' SG_ TotalCurrent : 0|16@1- (0.1,0) [-1000|1000] "A" B']
        v["Pack.TotalCurrent"] = total * d.current
    return Vehicle("parallel", "\n".join(lines), v, {f"{n}_Temps": 1.0 for n in names}, truth)


def plain(temperatures: dict[str, np.ndarray], bits: str = "16@1- (0.1,0)", unit: str = "") -> Vehicle:
    """A current, a voltage and temperatures of any names, one message each; names may say the message first."""
    d = drive(8)
    lines = ['VERSION ""', "BU_: B", "BO_ 256 Elec: 8 B",
             ' SG_ PackCurrent : 0|16@1- (0.1,0) [-1000|1000] "A" B',
             ' SG_ PackVoltage : 16|16@1+ (0.01,0) [0|600] "V" B']  # fmt: skip
    v = {"Elec.PackCurrent": d.current, "Elec.PackVoltage": d.voltage}
    for k, (name, x) in enumerate(temperatures.items()):
        message, _, own = name.rpartition(".")
        lines += [f"BO_ {512 + k} {message or f'Thermal_{name}'}: 8 B", f' SG_ {own} : 0|{bits} [0|0] "{unit}" B']
        v[f"{message or f'Thermal_{name}'}.{own}"] = x
    period = {f"Thermal_{name}" if "." not in name else name.partition(".")[0]: 1.0 for name in temperatures}
    return Vehicle("plain", "\n".join(lines), v, period, {})
