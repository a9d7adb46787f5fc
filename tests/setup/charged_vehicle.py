"""A vehicle whose current, voltage and charge agree or contradict each other."""

import numpy as np

from tests.setup.vehicles import drive, plain

SOC = '\nBO_ 900 State: 8 B\n SG_ BatterySOC : 0|16@1+ (0.01,0) [0|100] "%" B'


def charged(sign: float, voltage: float | None = 1.0, soc: float = 1.0):
    """A drive whose current counts charge positive where `sign` is −1; `voltage` −1 turns the pack's steps round."""
    d = drive(8)
    vehicle = plain({f"CellTemp{k + 1}": d.surface[:, k] for k in range(4)}, unit="degC")
    vehicle.dbc += SOC
    vehicle.values["Elec.PackCurrent"] = sign * d.current
    vehicle.values["State.BatterySOC"] = 50 + soc * 100 * (d.soc - d.soc.mean())
    at_rest = 46.0
    vehicle.values["Elec.PackVoltage"] = (
        np.full(len(d.t), at_rest) if voltage is None else at_rest - voltage * 0.01 * d.current
    )
    return vehicle
