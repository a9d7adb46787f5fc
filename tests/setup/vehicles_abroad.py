"""Vehicles whose DBC speaks French, Dutch or the dialect of a bus maker: thermistors in 1 K steps, no or two inlets."""

import numpy as np

from tests.setup.vehicles import CELLS, SECONDS, Vehicle, drive


def french() -> Vehicle:
    """Motorola order, an offset in the current, charge positive; one thermistor a multiplexer value, by letters."""
    d, n = drive(11), SECONDS * 10
    lines = ['VERSION ""', "BU_: CALC", "BO_ 1024 BATT_ELEC: 8 CALC",
             ' SG_ BAT_Courant : 7|16@0+ (0.1,-800) [-800|5753.5] "A" CALC',
             ' SG_ BAT_Tension : 23|16@0+ (0.1,0) [0|1000] "V" CALC',
             ' SG_ BAT_EtatCharge : 39|8@0+ (0.5,0) [0|100] "%" CALC',
             ' SG_ BAT_Compteur : 59|4@0+ (1,0) [0|15] "" CALC',
             "BO_ 1025 BATT_TEMP: 8 CALC", ' SG_ BAT_SelModule M : 7|8@0+ (1,0) [0|7] "" CALC']  # fmt: skip
    names = [f"BAT_TempModule_{chr(65 + k)}" for k in range(CELLS)]
    lines += [f' SG_ {name} m{k} : 15|8@0+ (1,-40) [-40|200] "degC" CALC' for k, name in enumerate(names)]
    lines += ["BO_ 1026 BATT_LIM: 8 CALC",
              ' SG_ BAT_CourantMaxDecharge : 7|16@0+ (0.1,0) [0|800] "A" CALC',
              ' SG_ BAT_TempMaxAutorisee : 23|8@0+ (1,-40) [-40|200] "degC" CALC',
              ' SG_ HAB_TempExterieure : 31|8@0+ (0.5,-40) [-40|80] "degC" CALC']  # fmt: skip
    v = {
        "BATT_ELEC.BAT_Courant": -d.current,
        "BATT_ELEC.BAT_Tension": d.voltage,
        "BATT_ELEC.BAT_EtatCharge": 100 * d.soc,
        "BATT_LIM.BAT_CourantMaxDecharge": np.full(n, 350.0),
        "BATT_LIM.BAT_TempMaxAutorisee": np.full(n, 55.0),
        "BATT_LIM.HAB_TempExterieure": np.full(n, 17.0),
    } | {f"BATT_TEMP.{name}": d.surface[:, k] for k, name in enumerate(names)}
    truth: dict[str, tuple[str, int | None]] = {
        "BATT_ELEC.BAT_Courant": ("current", None),
        "BATT_ELEC.BAT_Tension": ("voltage", None),
        "BATT_ELEC.BAT_EtatCharge": ("soc", None),
        "BATT_LIM.HAB_TempExterieure": ("coolant_inlet", None),
    } | {f"BATT_TEMP.{name}": ("surface", k + 1) for k, name in enumerate(names)}
    return Vehicle("french", "\n".join(lines), v, {"BATT_LIM": 1.0}, truth, scale={"current": -1.0})


def scooter() -> Vehicle:
    """Dutch; fourteen cells in series that say only the greatest, least and mean temperature, and no coolant."""
    d = drive(12, amps=60)
    lines = ['VERSION ""', "BU_: Vector__XXX", "BO_ 801 BMS_Msg1: 8 Vector__XXX",
             ' SG_ Stroom : 0|32@1- (0.001,0) [0|0] "A" Vector__XXX',
             ' SG_ Spanning : 32|32@1+ (0.001,0) [0|0] "V" Vector__XXX',
             "BO_ 802 BMS_Msg2: 8 Vector__XXX",
             ' SG_ MaxCelTemp : 0|8@1- (1,0) [0|0] "degC" Vector__XXX',
             ' SG_ MinCelTemp : 8|8@1- (1,0) [0|0] "degC" Vector__XXX',
             ' SG_ GemCelTemp : 16|8@1- (1,0) [0|0] "degC" Vector__XXX',
             ' SG_ FetTemp : 24|8@1- (1,0) [0|0] "degC" Vector__XXX',
             ' SG_ Laadtoestand : 32|8@1+ (1,0) [0|100] "%" Vector__XXX',
             ' SG_ MaxCelSpanning : 40|16@1+ (0.001,0) [0|0] "V" Vector__XXX']  # fmt: skip
    volts = d.cell_voltage[:, :14]
    v = {
        "BMS_Msg1.Stroom": d.current,
        "BMS_Msg1.Spanning": volts.sum(axis=1),
        "BMS_Msg2.MaxCelTemp": d.surface.max(axis=1),
        "BMS_Msg2.MinCelTemp": d.surface.min(axis=1),
        "BMS_Msg2.GemCelTemp": d.surface.mean(axis=1),
        "BMS_Msg2.FetTemp": 30 + d.t / 25,
        "BMS_Msg2.Laadtoestand": 100 * d.soc,
        "BMS_Msg2.MaxCelSpanning": volts.max(axis=1),
    }
    truth: dict[str, tuple[str, int | None]] = {
        "BMS_Msg1.Stroom": ("current", None),
        "BMS_Msg1.Spanning": ("voltage", None),
        "BMS_Msg2.Laadtoestand": ("soc", None),
    } | {f"BMS_Msg2.{which}CelTemp": ("surface", None) for which in ("Max", "Min", "Gem")}
    return Vehicle("scooter", "\n".join(lines), v, {"BMS_Msg2": 0.5}, truth)


def bus() -> Vehicle:
    """29-bit identifiers; two packs in series, each with its own thermistors and its own water."""
    d, n = drive(13, amps=200), SECONDS * 10
    lines = ['VERSION ""', "BU_: ESS", f"BO_ {0x80000000 | 0x18FF50F4} EssStatus01: 8 ESS",
             ' SG_ EssBusCurrent : 0|16@1+ (0.1,-3200) [-3200|3225.5] "A" ESS',
             ' SG_ EssBusVoltage : 16|16@1+ (0.1,0) [0|6425.5] "V" ESS',
             ' SG_ EssSoC : 32|8@1+ (0.4,0) [0|100] "%" ESS',
             ' SG_ EssInsulation : 40|16@1+ (1,0) [0|64255] "kOhm" ESS']  # fmt: skip
    v = {
        "EssStatus01.EssBusCurrent": d.current,
        "EssStatus01.EssBusVoltage": d.voltage,
        "EssStatus01.EssSoC": 100 * d.soc,
        "EssStatus01.EssInsulation": np.full(n, 1200.0),
    }
    truth: dict[str, tuple[str, int | None]] = {
        "EssStatus01.EssBusCurrent": ("current", None),
        "EssStatus01.EssBusVoltage": ("voltage", None),
        "EssStatus01.EssSoC": ("soc", None),
    }
    for m in (1, 2):
        lines.append(f"BO_ {0x80000000 | (0x18FF5FF4 + (m << 8))} EssPackTemps{m}: 8 ESS")
        for j in range(4):
            name = f"EssPack{m}Ntc{j + 1}"
            lines.append(f' SG_ {name} : {8 * j}|8@1+ (1,-40) [-40|210] "deg C" ESS')
            v[f"EssPackTemps{m}.{name}"] = d.surface[:, 4 * (m - 1) + j]
            truth[f"EssPackTemps{m}.{name}"] = ("surface", j + 1)
        for k, (way, more) in enumerate((("In", 0.0), ("Out", 2.0))):
            name = f"EssPack{m}Water{way}"
            lines.append(f' SG_ {name} : {32 + 8 * k}|8@1+ (1,-40) [-40|210] "deg C" ESS')
            v[f"EssPackTemps{m}.{name}"] = d.inlet + more + (m - 1)
        truth[f"EssPackTemps{m}.EssPack{m}WaterIn"] = ("coolant_inlet", None)
    return Vehicle("bus", "\n".join(lines), v, {"EssPackTemps1": 1.0, "EssPackTemps2": 1.0}, truth)


ABROAD = {f.__name__: f for f in (french, scooter, bus)}
