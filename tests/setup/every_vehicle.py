"""All made-up vehicles by name."""

from tests.setup.vehicles import VEHICLES
from tests.setup.vehicles_abroad import ABROAD
from tests.setup.vehicles_afar import AFAR

EVERY = {**VEHICLES, **ABROAD, **AFAR}
