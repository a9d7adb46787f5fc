"""A machine's clocks of which a test is master."""

from bms_gateway.bus.clock import BusClock

SECOND = 1_000_000_000
START = 1_700_000_000
LATE_S = 1e-6  # whoever sleeps wakes up late


class Time:
    """The clocks of a machine on which time passes only when told."""

    def __init__(self):
        self.ns, self.wall_off_ns = 50 * SECOND, START * SECOND

    def pass_s(self, seconds):
        self.ns += round(seconds * 1e9)

    def monotonic(self):
        return self.ns / 1e9

    def wall_ns(self):
        return self.ns + self.wall_off_ns

    def bus_clock(self):
        return BusClock(self.wall_ns, lambda: self.ns)
