"""A small sound config in a folder, to be spoilt by tests."""

from pathlib import Path

from tests.config.model_texts import EXAMPLE

DBC = """\
VERSION "1.0"

NS_ :

BS_:

BU_: VEHICLE

BO_ 256 Pack: 8 VEHICLE
 SG_ Current : 0|16@1- (10,0) [-327680|327670] "mA" Vector__XXX
 SG_ Voltage : 16|16@1+ (100,0) [0|600000] "mV" Vector__XXX
 SG_ Soc : 32|8@1+ (0.5,0) [0|100] "%" Vector__XXX
 SG_ Flow : 40|8@1+ (0.1,0) [0|25] "l/min" Vector__XXX
 SG_ InletF : 48|16@1+ (0.1,0) [0|500] "degF" Vector__XXX

BO_ 2566844672 Temps: 8 VEHICLE
 SG_ Mux M : 0|8@1+ (1,0) [0|2] "" Vector__XXX
 SG_ T1 m0 : 8|16@1+ (0.01,-100) [-100|500] "C" Vector__XXX
 SG_ T2 m0 : 24|16@1+ (0.01,-100) [-100|500] "C" Vector__XXX
 SG_ T3 m1 : 8|16@1+ (0.01,-100) [-100|500] "C" Vector__XXX
 SG_ T4 m1 : 24|16@1+ (0.01,-100) [-100|500] "C" Vector__XXX
 SG_ T5 m2 : 8|16@1+ (0.1,173.15) [173.15|500] "K" Vector__XXX
"""

OWN = """\
[bus]
channel = "vcan0"

[[string]]
name = "string_1"
model = "string_1.toml"
"""

MAPPED = """\
[bus]
interface = "socketcan"
channel = "vcan0"
dbc = ["vehicle.dbc"]
transmit = true

[[string]]
name = "string_1"
model = "string_1.toml"
[string.signals]
current = { signal = "Pack.Current", scale = -1.0 }
coolant_inlet = "Pack.InletF"
voltage = "Pack.Voltage"
soc = "Pack.Soc"
coolant_flow = "Pack.Flow"
[string.signals.surface]
1 = "Temps.T1"
3 = { signal = "Temps.T3", offset = 0.5 }
5 = "Temps.T5"

[identify]
method = "window"
[store]
path = "state"
"""


def write(folder: Path, config: str = MAPPED, model: str = EXAMPLE) -> Path:
    """Write gateway.toml, string_1.toml and vehicle.dbc; returns the path of the config."""
    (folder / "string_1.toml").write_text(model, encoding="utf-8")
    (folder / "vehicle.dbc").write_text(DBC, encoding="utf-8")
    file = folder / "gateway.toml"
    file.write_text(config, encoding="utf-8")
    return file
