"""The bins of the error by regime belong to the record: two models of it are compared bin by bin."""

from dataclasses import replace

import bms_gateway as bms
from bms_gateway.config.dbc_files import shipped


def test_the_bins_of_a_model_with_other_time_constants_are_the_same() -> None:
    # Bug: "rms current of the last minutes" was smoothed over the time constant of each model: 54 A here, 42 A there.
    model = bms.read_model(str(shipped("deploy/worked/bench.toml")))
    (record,) = bms.read_records(str(shipped("deploy/worked/bench.csv.gz")), model=model)
    slow = replace(
        model, priors={**model.priors, "R_u": replace(model.priors["R_u"], value=4.0 * model.priors["R_u"].value)}
    )
    seen = []
    for m in (model, slow):
        c = bms.compare(m, record).comparison
        for v in (c.filed, c.refitted):
            seen.append({r.feature: tuple((b.label, b.readings) for b in r.bins) for r in v.sensors[0].regimes})
            titles = {r.feature: r.title for r in v.sensors[0].regimes}
            assert titles["recent_heat"] == "rms current of the last 5 min (I²)"
    assert {"recent_heat", "surface", "current"} <= seen[0].keys()
    assert all(other == seen[0] for other in seen[1:])
