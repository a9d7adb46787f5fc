"""The model of the measured cell."""

from tests.config.bench_cell import one_cell

MODEL = one_cell(4.4, C_c=(140.0, 0.1), C_s=(12.0, 0.25), R_e=(8.0, 0.7), R_c=(2.5, 0.7), R_u=(5.0, 0.7))
