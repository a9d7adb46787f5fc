"""The string whose cells are told apart."""

from bms_gateway.thermal import Prior, StringModel
from tests.truth.string import C_F, TABLE_1

REL_SD = {"C_c": 0.05, "C_s": 0.05, "R_e": 0.6, "R_c": 0.05, "R_u": 0.1, "R_cc": 0.2, "C_f": 0.05}


ENDS, ALL = (1, 5), (1, 2, 3, 4, 5)


def model(sensors=ENDS, cells=5, condition="full", **rel_sd):
    values = {**TABLE_1, "R_cc": 4.0, "C_f": C_F}
    sd = {**REL_SD, **rel_sd}
    return StringModel(cells, sensors, condition, {k: Prior(v, sd[k]) for k, v in values.items()}, coolant="ntu")
