"""The engine's state on disk, across restarts and power cuts."""

from bms_gateway.store.state import Loaded, StateStore

__all__ = ["Loaded", "StateStore"]
