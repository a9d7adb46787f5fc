"""Core temperatures of battery cells, estimated from CAN traffic and broadcast on the bus, after X. Lin et al.

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
* `service`: the live loop; `workbench`: the local page; `fleet`: many logs; `setup`: a new vehicle.
* `chaos`: faults on purpose.
* `cli`: the commands.

A checkout has a README in the package's folder with a glossary, the path of a frame, and how to add something.
"""

__version__ = "0.1.0"
