"""Logs with a hidden effect as records: what the tests of the diagnosis compare and search."""

from functools import cache

from bms_gateway.config.model_file import parse_model
from bms_gateway.diagnosis.candidates import Candidate
from bms_gateway.diagnosis.record import make_record
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.thermal.effects import effect_named
from tests.truth.hidden import Scenario, make_log


def record_of(log, *, core=False):
    """Record and nominal model of a log; with the cores' temperatures as if thermocouples sat in them."""
    t, model = log.table, parse_model(log.model)
    record = make_record(
        Columns(
            time_s=t["time_s"],
            current_A=t["current_A"],
            coolant_inlet_C=t["coolant_inlet_C"],
            voltage_V=t.get("voltage_V"),
            soc=t.get("soc"),
            coolant_flow_m3_s=t.get("coolant_flow_m3_s"),
            surface_C={int(k.split("_")[1]): v for k, v in t.items() if k.startswith("surface_")},
            core_C={k + 1: log.core[:, k] for k in range(log.core.shape[1])} if core else {},
            source=log.scenario.name,
        ),
        model,
    )
    return record, model


@cache
def hidden(effect=None, size="medium", cell=None, **scenario):
    """Log, record and model of one scenario, made once."""
    log = make_log(Scenario(effects={} if effect is None else {effect: (size, cell)}, **scenario))
    return (log, *record_of(log))


def named(key):
    """The candidate that a user calls `name` or `name:cell`."""
    name, _, cell = key.partition(":")
    return Candidate(effect_named(name), int(cell) if cell else None)
