"""Runs beside the gateway while a restored state is on trial, and says that loop and ticks go on."""

import asyncio
from typing import Final

from bms_gateway.service.live import OVERDUE_NS, Gateway
from bms_gateway.store import Trial

PERIOD_S: Final = 1.0  # several of them within `store.trial.HANG_S`
TICKS: Final = 60  # after a minute of ticks each part of the engine has had its turn


async def prove(gateway: Gateway, trial: Trial) -> None:
    """Watch over the first minute of ticks; sooner the first save proves the state as well.

    Parameters
    ----------
    gateway : Gateway
    trial : Trial
        Over when this returns.
    """
    while not gateway.tally.saves and gateway.tally.ticks < TICKS:
        due = gateway.engine.next_deadline()
        if due is None or gateway.port.now_ns() - due < OVERDUE_NS:
            trial.alive()
        await asyncio.sleep(PERIOD_S)
    trial.over()
