"""Faulty states that a start of the service can find on disk."""

import hashlib
from pathlib import Path
from typing import Final

from bms_gateway.chaos.reaction import Counted, Quiet
from bms_gateway.chaos.scenario import Injection, Scenario
from bms_gateway.store.state import MAGIC, VERSION

STOPPED_S: Final = 20.0
LOOP_S: Final = 10.0  # one start a second: three with each of two generations of the state, and one that succeeds
LISTS: Final = 15_000_000
RECOVERS_S: Final = 60.0


def state_scenarios() -> list[Scenario]:
    """Make all scenarios of this room; they do not depend on the config."""
    aside = Counted.of("set_aside")

    def one(name: str, fault: str, injection: Injection, lasts_s: float = STOPPED_S) -> Scenario:
        return Scenario(name, "service", fault, (aside, Quiet(5)), lasts_s, RECOVERS_S, injection)

    return [
        one(
            "crash-loop",
            "the service ends at its first tick whenever it has restored its state, and is started again each second",
            Injection(restart=True, ends=True),
            LOOP_S,
        ),
        one("state-torn", "half of the newest state is there after a stop", Injection(restart=True, stored=_torn)),
        one(
            "state-bomb",
            f"{3 * LISTS / 1e6:.0f} MB of empty lists with a sound check sum lie in the place of the state",
            Injection(restart=True, stored=_bomb),
        ),
    ]


def _torn(directory: Path) -> None:
    state = directory / "state"
    state.write_bytes(state.read_bytes()[: state.stat().st_size // 2])


def _bomb(directory: Path) -> None:
    body = b'{"saved_ns":1,"state":{"a":[' + b"[]," * LISTS + b"[]]}}"
    head = b"%s %d %s %d\n" % (MAGIC, VERSION, hashlib.sha256(body).hexdigest().encode(), len(body))
    (directory / "state").write_bytes(head + body)
