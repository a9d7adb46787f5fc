"""From a table to a smaller error, as a script to copy: `python -m bms_gateway.examples [TABLE MODEL]`."""

import sys

import bms_gateway as bms
from bms_gateway.config.dbc_files import shipped


def main(table: str, model_file: str) -> None:
    """Fit, diagnose, add what is missing, and print the error on readings that no fit has seen."""
    model = bms.read_model(model_file)
    (record,) = bms.read_records(table, model=model)

    fitted = bms.fit(model, record)  # the numbers of the model, from these measurements
    print(f"fitted:    {fitted.report.errors.heldout_rmse_K:.3f} K on readings that were held out")

    found = bms.diagnose(model, record)  # which physical effect does the model lack?
    print(f"diagnosed: {found.verdict} {', '.join(found.effects)}")
    if found.effects:
        added = bms.add(model, record, *found.effects)  # refitted, and judged
        print(f"added:     {added.report.after.errors.heldout_rmse_K:.3f} K; {added.refused or 'nothing against it'}")
        model = added.model  # bms.write_model(model, "string_1b.toml") keeps it for the gateway

    cores = bms.fit(model, record).cores[0]  # of this record, with everything that is not known
    for k in range(model.cells):
        print(f"cell {k + 1}: core up to {cores.T_c[:, k].max():.1f} °C, ± {cores.total_K[:, k].max():.1f} K (1 sd)")


if __name__ == "__main__":
    worked = (str(shipped("deploy/worked/bench.csv.gz")), str(shipped("deploy/worked/bench.toml")))
    main(*(sys.argv[1:] or worked))
