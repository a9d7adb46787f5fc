"""Vehicles whose DBC is Chinese, writes units in words, or has a charging plug beside the coolant."""

import numpy as np

from tests.setup.vehicles import CELLS, SECONDS, SERIES, Vehicle, drive


def chinese() -> Vehicle:
    """Names in Pinyin and the unit of temperature in GBK; the greatest voltage of a cell tells how many there are."""
    d, n = drive(21), SECONDS * 10
    lines = ['VERSION ""', "BU_: BMS", "BO_ 1092 DianChiBao1: 8 BMS",
             ' SG_ ZongDianYa : 0|16@1+ (0.1,0) [0|1000] "V" BMS',
             ' SG_ ZongDianLiu : 16|16@1+ (0.1,-1000) [-1000|1000] "A" BMS',
             ' SG_ ShengYuDianLiang : 32|8@1+ (0.5,0) [0|100] "%" BMS',
             "BO_ 1093 DianChiBao2: 8 BMS",
             ' SG_ ZuiGaoWenDu : 0|8@1+ (1,-40) [-40|210] "℃" BMS',
             ' SG_ ZuiDiWenDu : 8|8@1+ (1,-40) [-40|210] "℃" BMS',
             ' SG_ ZuiGaoDanTiDianYa : 16|16@1+ (0.001,0) [0|5] "V" BMS',
             "BO_ 1094 DanTiWenDu: 8 BMS", ' SG_ WenDuZu M : 0|8@1+ (1,0) [0|3] "" BMS']  # fmt: skip
    for k in range(CELLS):
        lines.append(f' SG_ DanTiWenDu{k + 1:02d} m{k // 4} : {8 + 8 * (k % 4)}|8@1+ (1,-40) [-40|210] "℃" BMS')
    lines += ["BO_ 1095 DianJi: 8 BMS", ' SG_ DianJiWenDu : 0|8@1+ (1,-40) [-40|210] "℃" BMS',
              ' SG_ HuanJingWenDu : 8|8@1+ (1,-40) [-40|210] "℃" BMS',
              ' SG_ DianJiDianLiu : 24|16@1+ (0.1,-1000) [-1000|1000] "A" BMS']  # fmt: skip
    v = {
        "DianChiBao1.ZongDianYa": d.voltage,
        "DianChiBao1.ZongDianLiu": d.current,
        "DianChiBao1.ShengYuDianLiang": 100 * d.soc,
        "DianChiBao2.ZuiGaoWenDu": d.surface.max(axis=1),
        "DianChiBao2.ZuiDiWenDu": d.surface.min(axis=1),
        "DianChiBao2.ZuiGaoDanTiDianYa": d.cell_voltage.max(axis=1),
        "DianJi.DianJiWenDu": 35 + d.t / 20,
        "DianJi.HuanJingWenDu": np.full(n, 17.0),
        "DianJi.DianJiDianLiu": 1.1 * d.current,
    }
    v |= {f"DanTiWenDu.DanTiWenDu{k + 1:02d}": d.surface[:, k] for k in range(CELLS)}
    truth: dict[str, tuple[str, int | None]] = {
        "DianChiBao1.ZongDianLiu": ("current", None),
        "DianChiBao1.ZongDianYa": ("voltage", None),
        "DianChiBao1.ShengYuDianLiang": ("soc", None),
        "DianJi.HuanJingWenDu": ("coolant_inlet", None),
    } | {f"DanTiWenDu.DanTiWenDu{k + 1:02d}": ("surface", k + 1) for k in range(CELLS)}
    return Vehicle("chinese", "\n".join(lines), v, {"DanTiWenDu": 0.5}, truth, encoding="gbk")


def worded() -> Vehicle:
    """Units in words, compounds as names; water that goes out of the chiller and comes back to it."""
    d = drive(22)
    lines = ['VERSION ""', "BU_: BMS", "BO_ 401 BMS_01: 8 BMS",
             ' SG_ BMS_IstStrom : 12|12@1+ (1,-2047) [-2047|2046] "Unit_Amper" BMS',
             ' SG_ BMS_IstSpannung : 24|12@1+ (0.25,0) [0|1023.25] "Unit_Volt" BMS',
             ' SG_ BMS_SOC : 48|11@1+ (0.05,0) [0|102.3] "Unit_PerCent" BMS',
             "BO_ 402 BMS_02: 8 BMS", ' SG_ BMS_MaxLadeStrom : 0|12@1+ (1,0) [0|4095] "Unit_Amper" BMS',
             "BO_ 403 BMS_Zelltemp: 8 BMS"]  # fmt: skip
    for k in range(CELLS):
        lines.append(f' SG_ BMS_Zelltemp_{k + 1:02d} : {8 * k}|8@1+ (0.5,-50) [-50|77] "Unit_DegreCelsi" BMS')
    lines += ["BO_ 404 TMS_01: 8 BMS", ' SG_ TMS_BackWaterTemp : 0|8@1+ (0.5,-50) [-50|77] "Unit_DegreCelsi" BMS',
              ' SG_ TMS_EnvTemp : 8|8@1+ (0.5,-50) [-50|77] "Unit_DegreCelsi" BMS',
              ' SG_ TMS_Motortemp : 16|8@1+ (1,-50) [-50|200] "Unit_DegreCelsi" BMS']  # fmt: skip
    v = {
        "BMS_01.BMS_IstStrom": -d.current,
        "BMS_01.BMS_IstSpannung": d.voltage,
        "BMS_01.BMS_SOC": 100 * d.soc,
        "BMS_02.BMS_MaxLadeStrom": 200 + 20 * d.soc,
        "TMS_01.TMS_BackWaterTemp": d.inlet + 2,
        "TMS_01.TMS_EnvTemp": np.full(SECONDS * 10, 18.0),
        "TMS_01.TMS_Motortemp": 40 + d.t / 20,
    } | {f"BMS_Zelltemp.BMS_Zelltemp_{k + 1:02d}": d.surface[:, k] for k in range(CELLS)}
    truth: dict[str, tuple[str, int | None]] = {
        "BMS_01.BMS_IstStrom": ("current", None),
        "BMS_01.BMS_IstSpannung": ("voltage", None),
        "BMS_01.BMS_SOC": ("soc", None),
        "TMS_01.TMS_EnvTemp": ("coolant_inlet", None),
    } | {f"BMS_Zelltemp.BMS_Zelltemp_{k + 1:02d}": ("surface", k + 1) for k in range(CELLS)}
    period = {"BMS_02": 0.5, "BMS_Zelltemp": 0.5, "TMS_01": 1.0}
    return Vehicle("worded", "\n".join(lines), v, period, truth, scale={"current": -1.0})


def storage() -> Vehicle:
    """One temperature of the battery, beside the least and greatest of the cells in K; the water of a charging plug."""
    d = drive(23, amps=60)
    lines = ['VERSION ""', "BU_: B", "BO_ 854 BMS_Measured: 8 B",
             ' SG_ BatteryVoltage : 0|16@1- (0.01,0) [0|0] "V" B', ' SG_ BatteryCurrent : 16|16@1- (0.1,0) [0|0] "A" B',
             ' SG_ BatteryTemperature : 32|16@1- (0.1,0) [0|0] "degC" B',
             "BO_ 883 BMS_Extremes: 8 B",
             ' SG_ MinCellVoltage : 0|16@1+ (1,0) [0|0] "mV" B',
             ' SG_ MaxCellVoltage : 16|16@1+ (1,0) [0|0] "mV" B',
             ' SG_ MinCellTemperature : 32|16@1+ (0.1,0) [0|0] "K" B',
             ' SG_ MaxCellTemperature : 48|16@1+ (0.1,0) [0|0] "K" B',
             "BO_ 853 BMS_State: 8 B", ' SG_ SOCave : 0|16@1+ (1,0) [0|100] "%" B',
             "BO_ 900 EVSE: 8 B", ' SG_ Inlet_DC_Pos_Temp : 0|8@1+ (1,-40) [-40|120] "degC" B']  # fmt: skip
    volts = d.cell_voltage[:, :16]
    v = {
        "BMS_Measured.BatteryVoltage": volts.sum(axis=1),
        "BMS_Measured.BatteryCurrent": -d.current,
        "BMS_Measured.BatteryTemperature": d.surface.mean(axis=1),
        "BMS_Extremes.MinCellVoltage": 1000 * volts.min(axis=1),
        "BMS_Extremes.MaxCellVoltage": 1000 * volts.max(axis=1),
        "BMS_Extremes.MinCellTemperature": 273.15 + d.surface.min(axis=1),
        "BMS_Extremes.MaxCellTemperature": 273.15 + d.surface.max(axis=1),
        "BMS_State.SOCave": 100 * d.soc,
        "EVSE.Inlet_DC_Pos_Temp": 25 + d.t / 40,
    }
    truth: dict[str, tuple[str, int | None]] = {
        "BMS_Measured.BatteryCurrent": ("current", None),
        "BMS_Measured.BatteryVoltage": ("voltage", None),
        "BMS_State.SOCave": ("soc", None),
    } | {f"BMS_Extremes.{which}CellTemperature": ("surface", None) for which in ("Max", "Min")}
    period = {"BMS_Extremes": 0.5, "BMS_State": 1.0, "EVSE": 0.5}
    return Vehicle("storage", "\n".join(lines), v, period, truth, scale={"current": -1.0})


AFAR = {f.__name__: f for f in (chinese, worded, storage)}
IN_SERIES = {"chinese": SERIES, "storage": 16}
"""Cells in series of vehicles whose bus has only the greatest or least of their voltages."""
