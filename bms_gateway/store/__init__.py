"""What the gateway keeps on disk, across restarts and power cuts: its state, and the recent decoded signals."""

from bms_gateway.store.state import Loaded, StateStore
from bms_gateway.store.trial import Trial

__all__ = ["Loaded", "StateStore", "Trial"]
