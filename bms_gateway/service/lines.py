"""Notices of the engine as lines of the journal."""

import logging
from typing import Final

from bms_gateway.engine.events import Level, Notice
from bms_gateway.service.journal import NOTICE

SYSLOG_LEVELS: Final = {Level.WARNING: logging.WARNING, Level.NOTICE: NOTICE, Level.INFO: logging.INFO}


def write(log: logging.Logger, event: Notice) -> None:
    """Write the line of one notice, with the attributes of the notice."""
    where = "" if event.string is None else f" [{event.string}]"
    about = {"code": event.code, "string": event.string, "cell": event.cell}
    log.log(SYSLOG_LEVELS[event.level], "%s%s", event.text, where, extra=about)
