"""All scenarios by name, and the bench that runs each."""

from collections.abc import Callable, Mapping, Sequence

from bms_gateway.chaos.bus_faults import bus_scenarios
from bms_gateway.chaos.door_faults import door_scenarios
from bms_gateway.chaos.fault_targets import Facts
from bms_gateway.chaos.heat_faults import heat_scenarios
from bms_gateway.chaos.real_time import BusScenario, RealTimeBench
from bms_gateway.chaos.scenario import Outcome, Scenario
from bms_gateway.chaos.sensors import sensor_scenarios
from bms_gateway.chaos.service_faults import service_scenarios
from bms_gateway.chaos.state_faults import state_scenarios
from bms_gateway.chaos.stepped import SteppedBench
from bms_gateway.chaos.time_faults import time_scenarios
from bms_gateway.chaos.traffic_faults import frame_scenarios
from bms_gateway.engine.plan import Plan
from bms_gateway.errors import UsageError, did_you_mean
from bms_gateway.frames.database import Database

ORDER = ("bus", "service", "frame", "sensor", "heat", "time")


class Chaos:
    """Every scenario that fits a config and a bus.

    Parameters
    ----------
    plan, database
        Of the gateway's config.
    channel : str or None
        Interface; None: a bus inside this process, without the scenarios that need a kernel.
    seed : int
        Of the simulated pack.

    Attributes
    ----------
    scenarios : mapping of name to Scenario
        In the order in which they are run; `unfit` says why one cannot be run here.
    """

    def __init__(self, plan: Plan, database: Database, channel: str | None = None, seed: int = 0) -> None:
        self._plan, self._database, self._channel, self._seed = plan, database, channel, seed
        facts = Facts.of(plan, database, seed)
        self._bus: Mapping[str, BusScenario] = {
            s.scenario.name: s for s in [*bus_scenarios(channel), *service_scenarios(channel), *door_scenarios()]
        }
        stepped = [*frame_scenarios(facts), *sensor_scenarios(facts), *heat_scenarios(facts), *time_scenarios()]
        stepped += state_scenarios()
        found = [*(s.scenario for s in self._bus.values()), *stepped]
        self.scenarios: Mapping[str, Scenario] = {s.name: s for s in sorted(found, key=lambda s: ORDER.index(s.kind))}
        self._live: RealTimeBench | None = None

    def choose(self, names: Sequence[str]) -> list[str]:
        """Check the names of scenarios; without names, all scenarios are chosen.

        Raises
        ------
        UsageError
            There is no such scenario.
        """
        for name in names:
            if name not in self.scenarios:
                raise UsageError(f"chaos: --scenario {name}: no such scenario{did_you_mean(name, self.scenarios)}")
        return list(dict.fromkeys(names)) or list(self.scenarios)

    def run(self, name: str) -> Outcome:
        """Run one scenario.

        Raises
        ------
        BusError
            The interface cannot be used.
        """
        scenario = self.scenarios[name]
        if scenario.unfit:
            return Outcome(scenario)
        if name not in self._bus:
            return SteppedBench(self._plan, self._database, self._channel, self._seed).run(scenario)
        if self._live is None:
            self._live = RealTimeBench(self._plan, self._database, self._channel, self._seed)
        return self._live.run(self._bus[name])

    def run_all(self, names: Sequence[str], each: Callable[[Outcome], None] | None = None) -> list[Outcome]:
        """Run some scenarios, and report each when it ends."""
        outcomes = []
        for name in names:
            outcomes.append(self.run(name))
            if each is not None:
                each(outcomes[-1])
        return outcomes
