"""Runs beside the gateway while a restored state is on trial, and notes that loop and ticks continue."""

import asyncio
from typing import Final

from bms_gateway.service.live import OVERDUE_NS, Gateway
from bms_gateway.store import Trial

PERIOD_S: Final = 1.0  # several of them within `store.trial.HANG_S`
TICKS: Final = 60  # after a minute of ticks each part of the engine has worked


async def prove(gateway: Gateway, trial: Trial) -> None:
    """Watch the first minute of ticks; an earlier save proves the state as well.

    Parameters
    ----------
    gateway : Gateway
    trial : Trial
        The trial ends when this returns.
    """
    while not gateway.tally.saves and gateway.tally.ticks < TICKS:
        due = gateway.engine.next_deadline()
        if due is None or gateway.port.now_ns() - due < OVERDUE_NS:
            trial.alive()
        await asyncio.sleep(PERIOD_S)
    trial.over()
