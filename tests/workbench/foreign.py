"""Files as others have them: a German Excel CSV with names, units and signs of its own."""

import csv
from pathlib import Path


def german(source: Path, to: Path) -> Path:
    """Write one of our tables as a German Excel does: semicolons, decimal commas, its own names, charge positive."""
    names = {
        "time_s": ("Messzeit [min]", 1 / 60),
        "current_A": ("Packstrom, gesamt [mA]", -1000.0),
        "coolant_inlet_C": ("Kühlmittel-Vorlauf (°C)", 1.0),
        "soc": ("Ladezustand", 100.0),
        "coolant_flow_m3_s": ("Volumenstrom l/min", 60_000.0),
    }
    with source.open(newline="") as file:
        rows = list(csv.reader(file))
    head, *rest = rows
    found = [names.get(h, (f"T_Zelle_{h.split('_')[1]}" if h.startswith("surface") else h, 1.0)) for h in head]
    lines = [";".join(["Bemerkung", *(f'"{n}"' if "," in n else n for n, _ in found)])]
    for row in rest:
        cells = [
            f"{float(x) * factor:.6f}".replace(".", ",") if x else "" for x, (_, factor) in zip(row, found, strict=True)
        ]
        lines.append(";".join(["", *cells]))
    to.write_text("\r\n".join(lines) + "\r\n", encoding="cp1252")
    return to
