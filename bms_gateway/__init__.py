"""Battery core temperatures on the CAN bus, after Lin et al.

The rooms, from the ground up: `thermal` (physics) and `frames` (bytes and quantities); `identify`, `observe` and
`sensors` (parameters, states, what to measure); `health`; `engine` (frames and time in, frames and events out);
`bus`, `config`, `report`, `store`; `service`; `cli`. Imports point down only.
"""

__version__ = "0.1.0"
