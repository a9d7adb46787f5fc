"""What the gateway keeps on disk, across restarts and power cuts: its state, and the recent decoded signals."""

from bms_gateway.store.state import Loaded, StateStore

__all__ = ["Loaded", "StateStore"]
