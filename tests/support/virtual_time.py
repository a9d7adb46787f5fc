"""An event loop whose clock goes on only where it would wait: minutes in a moment, each timer at its very time."""

import asyncio
import selectors

START_S = 1000.0
MOST_TURNS = 200_000
"""Of a loop in a test; one that turns more often has no end."""


class _Selector(selectors.DefaultSelector):  # type: ignore[misc,valid-type]
    """Never waits: the time passes at once."""

    def __init__(self):
        super().__init__()
        self.now_s, self.turns = START_S, 0

    def select(self, timeout=None):
        self.turns += 1
        if self.turns > MOST_TURNS:
            raise AssertionError("the loop turns without end")
        found = super().select(0)
        if not found:
            if timeout is None:
                raise AssertionError("the loop waits for what never comes")
            self.now_s = round(self.now_s + max(0.0, timeout), 9)  # whole ns, so that instants can be compared
        return found


class VirtualLoop(asyncio.SelectorEventLoop):
    """For `asyncio.Runner`; what comes from threads it does not wait for."""

    def __init__(self):
        self._virtual = _Selector()
        super().__init__(self._virtual)

    def time(self):
        return self._virtual.now_s


def micros():
    """Time since the start of the running loop, µs."""
    return round((asyncio.get_running_loop().time() - START_S) * 1e6)
