"""Steps of a desk of the page, and the files that it reads."""

from tests.workbench.browser import come

PATIENCE_S = 300.0


def files(pack, table=None):
    return {"tables": [str(table or pack.hidden)], "model": str(pack.model), "config": "", "string": "", "columns": []}


def done(desk):
    """State once nothing runs any more."""
    come(lambda: desk.state()["job"] is None, lambda: desk.state()["job"], PATIENCE_S)
    return desk.state()
