"""A store that holds two states."""

from bms_gateway.store import StateStore

GOOD = {"generation": 2, "fill": "y" * 300}


def saved(folder):
    store = StateStore(folder)
    assert store.save({"generation": 1, "fill": "x" * 300}, wall_ns=1) is None
    assert store.save(GOOD, wall_ns=2) is None
    return store
