"""Model files as text, which the tests of many rooms take for their strings."""

EXAMPLE = """\
cells = 5
sensors = [1, 3, 5]              # measured surfaces, 1-based
condition = "full"               # full | natural | no-conduction | single
effects = []                     # e.g. ["resistance_temperature"], one [effect.NAME] table each

[cell]
capacity_Ah = 8.0                # for SOC by counting where no SOC is given

[parameters]                     # value with unit and either rel_sd (prior) or fixed = true; per cell: values = [..]
C_c  = { value = 268.0, unit = "J/K", rel_sd = 0.05 }
C_s  = { value = 18.8, unit = "J/K", rel_sd = 0.05 }
R_e  = { value = 3.5, unit = "mOhm", rel_sd = 0.6 }
R_c  = { value = 1.266, unit = "K/W", rel_sd = 0.6 }
R_u  = { value = 0.79, unit = "K/W", rel_sd = 0.6 }
R_cc = { value = 4.0, unit = "K/W", rel_sd = 0.4 }     # strings only
C_f  = { value = 11.33, unit = "W/K", rel_sd = 0.05 }  # strings only; at nominal flow
coolant_flow = { value = 0.0095, unit = "m3/s" }       # the nominal flow

[tolerances]                     # what is not a missing effect; defaults shown
cell_R_e = 0.02
cell_R_u = 0.02
cell_R_c = 0.03
surface_offset_K = 0.05
inlet_offset_K = 0.05
"""


WITH_EFFECTS = (
    EXAMPLE.replace("effects = []", 'effects = ["entropic_heat", "cell_resistance", "charge_transfer"]')
    + """
[effect.entropic_heat]
dUdT = { value = 0.55, unit = "mV/K", sd = 0.04 }

[effect.cell_resistance]
cell = 4
a = { value = 15, unit = "%", sd = 3 }

[effect.charge_transfer]
I_0 = { value = 12.0, unit = "A", rel_sd = 0.3 }
E = { value = 5000.0, unit = "K", fixed = true }

[correlation]
names = ["R_e", "entropic_heat.dUdT", "cell_resistance.a"]
matrix = [
  [1.0, -0.4, 0.1],
  [-0.4, 1.0, 0.0],
  [0.1, 0.0, 1.0],
]

[before]
C_c  = { value = 268.0, unit = "J/K", rel_sd = 0.05 }
C_s  = { value = 18.8, unit = "J/K", rel_sd = 0.05 }
R_e  = { value = 3.5, unit = "mOhm", rel_sd = 0.6 }
R_c  = { value = 1.266, unit = "K/W", rel_sd = 0.6 }
R_u  = { value = 0.79, unit = "K/W", rel_sd = 0.6 }
R_cc = { value = 4.0, unit = "K/W", rel_sd = 0.4 }
C_f  = { value = 11.33, unit = "W/K", rel_sd = 0.05 }
"""
)
