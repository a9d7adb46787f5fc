"""What is proposed for a made-up vehicle."""

from bms_gateway.setup.proposal import Proposal
from bms_gateway.setup.propose import propose
from bms_gateway.setup.vehicle_logs import read_traffic
from tests.setup.vehicles import Vehicle, write


def proposed(vehicle: Vehicle, folder) -> Proposal:
    log, dbc = write(vehicle, folder)
    return propose(read_traffic([log], [dbc]))
