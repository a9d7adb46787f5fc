"""Core temperatures of battery cells, estimated from CAN traffic and broadcast on the bus, after X. Lin et al.

As a library::

    import bms_gateway as bms

    model = bms.read_model("string_1.toml")
    drive = bms.Columns(time_s=t, current_A=I, coolant_inlet_C=T_in, surface_C={1: T_1, 12: T_12})
    cores = bms.Observer(model).run(drive)
    cores.core_C, cores.core_sd_K

`__all__` has the names that stay; what they need is loaded with the first of them. All other modules may change.

The rooms, from the ground up; a room imports from the lines above its own only:

* `errors`: every exception that the package raises on purpose; `gunzip`: gzip data read in bounded pieces.
* `thermal`: the physics and its catalogue of effects; `frames`: bytes and physical values.
* `identify`: parameters; `observe`: temperatures and their bands; `sensors`: which surfaces to measure.
* `health`: what an estimate means: ageing, faults, alerts.
* `engine`: frames and time in, frames and events out; `diagnosis`: which effect a model lacks; `reproduce`: the paper's
  figures and tables.
* `bus`: where frames come from and go to; `config`: TOML files; `report`: results as text, tables and pages; `store`:
  what is kept on disk.
* `records`: tables and logs as records of one string.
* `service`: the live loop; `workbench`: the local page; `fleet`: many logs; `setup`: a new vehicle; `library`: the
  names below.
* `chaos`: faults on purpose.
* `cli`: the commands; `examples`: from a table to a smaller error, as a script.

A checkout has a README in the package's folder with a glossary, the path of a frame, and how to add something.
"""

TYPE_CHECKING = False  # true for a checker of types; `typing` itself is not worth its loading here
if TYPE_CHECKING:
    from bms_gateway.errors import GatewayError
    from bms_gateway.library.decoding import Signal, decode
    from bms_gateway.library.modelling import (
        Added,
        Columns,
        Compared,
        Diagnosed,
        Fit,
        Record,
        add,
        compare,
        diagnose,
        fit,
        read_records,
    )
    from bms_gateway.library.models import StringModel, cell_model, read_model, write_model
    from bms_gateway.library.observer import Cores, Observer
    from bms_gateway.library.placing import Placed, place

__version__ = "0.1.0"

_HOMES = {
    "errors": ("GatewayError",),
    "library.decoding": ("Signal", "decode"),
    "library.modelling": (
        *("Added", "Columns", "Compared", "Diagnosed", "Fit", "Record"),
        *("add", "compare", "diagnose", "fit", "read_records"),
    ),
    "library.models": ("StringModel", "cell_model", "read_model", "write_model"),
    "library.observer": ("Cores", "Observer"),
    "library.placing": ("Placed", "place"),
}
"""Module of each name. A service loads none of them."""

__all__ = [
    "Added",
    "Columns",
    "Compared",
    "Cores",
    "Diagnosed",
    "Fit",
    "GatewayError",
    "Observer",
    "Placed",
    "Record",
    "Signal",
    "StringModel",
    "__version__",
    "add",
    "cell_model",
    "compare",
    "decode",
    "diagnose",
    "fit",
    "place",
    "read_model",
    "read_records",
    "write_model",
]


def __getattr__(name: str) -> object:
    """Load a public name when it is first asked for."""
    from importlib import import_module

    for module, names in _HOMES.items():
        if name in names:
            found: object = getattr(import_module(f"{__name__}.{module}"), name)
            globals()[name] = found
            return found
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names, loaded or not."""
    return sorted({*globals(), *__all__})
