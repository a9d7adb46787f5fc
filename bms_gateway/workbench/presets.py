"""Cells of the catalogue, for the form of the model."""

from bms_gateway.thermal.cells import FORMATS, PUBLISHED


def presets() -> list[dict[str, str]]:
    """Give the cells of the catalogue, for a list to choose from."""
    told = []
    for c in (*PUBLISHED.values(), *FORMATS.values()):
        size = " × ".join(f"{1e3 * x:g}" for x in c.size)
        known = [c.chemistry or "", f"{c.capacity_Ah:g} Ah" if c.capacity_Ah else "", f"{size} mm"]
        told.append({"name": c.name, "told": ", ".join(x for x in known if x)})
    return told
