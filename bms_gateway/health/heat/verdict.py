"""Verdict on one string by its evidence: which fault, since when, how probable, and which other causes are possible."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isnan, nan, sqrt

import numpy as np

from bms_gateway.health.heat import levels, many_heats
from bms_gateway.health.heat.course import COOLING_BACK, FROZEN_K, FROZEN_S, MISSING_BACK, Course
from bms_gateway.health.heat.fault_evidence import Evidence, Kind, Weighed
from bms_gateway.health.heat.few_thermocouples import hold_films
from bms_gateway.health.heat.filter import HeatFilter
from bms_gateway.health.heat.finding import Finding, SeenStep, held, lasted
from bms_gateway.health.heat.frozen import THAWED_S, frozen, note_still, shown_by, thawed
from bms_gateway.health.heat.heat_end import ENDED_S, LEAST_RATE, has_ended, heat_there
from bms_gateway.health.heat.layout import Bools
from bms_gateway.health.heat.many_heats import SURE, Together
from bms_gateway.health.heat.prior_odds import excluded, ln_prior
from bms_gateway.health.heat.proven import early, known, may_be_else, may_be_heat, proven, undecided, watched
from bms_gateway.health.heat.sentences import others, sentence
from bms_gateway.health.heat.shared_heat import share_out
from bms_gateway.health.heat.slips import BURNT_C, COLDER_S, as_found, failed_since, heats_at, left_by
from bms_gateway.health.heat.standing import HOLD_COMMON_S, HOLD_S, INLET_OFF, INLET_SURE, Standing
from bms_gateway.thermal import Floats


@dataclass(slots=True)
class Verdict:
    """Verdict on string `s` of a filter.

    Attributes
    ----------
    findings : list of Finding
    aside : ndarray of bool (m,)
        Thermocouples whose readings are not used.
    still : ndarray (m,), s
        How long a thermocouple has stood unusually still, and 0; its readings are not used either.
    woke_ns : int or None
        When the string last woke from a sleep.
    seen : SeenStep
        What the last step showed.
    burning : bool
        Whether a surface of the string is over its limit, or a cell runs away: heat of the string has then not ended.
    """

    s: int
    of: HeatFilter
    evidence: Evidence
    course: Course
    aside: np.ndarray[tuple[int], np.dtype[np.bool_]] = field(init=False)
    still: Floats = field(init=False)
    findings: list[Finding] = field(default_factory=list)
    woke_ns: int | None = None
    seen: SeenStep = field(init=False)
    burning: bool = False
    _proven: bool = False
    _stands: int = 0
    _stood_ns: int = 0
    _standing: Standing = field(init=False)
    _residual: Floats = field(default_factory=lambda: np.zeros(0))
    _residual_sd: Floats = field(default_factory=lambda: np.zeros(0))
    _shows: Mapping[Kind, Floats] = field(default_factory=dict)
    _also: dict[int, int] = field(default_factory=dict)
    _inlet_C: float = nan

    def __post_init__(self) -> None:
        m = self.of.at.sensed
        self.aside, self.still = np.zeros(m, np.bool_), np.zeros(m)
        self.seen = SeenStep(np.ones(m, np.bool_), np.zeros(m), cools=False, age_s=0.0)
        self._standing = Standing(self.s, self.of, self.evidence, self.course)

    @property
    def hot(self) -> bool:
        """Whether heat of a cell's own has been found."""
        return bool(self._hot_cells)

    @property
    def _hot_cells(self) -> list[Finding]:
        return [g for g in self.findings if g.code == "unexplained_heat"]

    @property
    def jumped(self) -> Bools:
        """Which thermocouples (m,) have been found to have jumped."""
        return np.isin(np.arange(len(self.aside)), [g.place for g in self.findings if g.kind is Kind.JUMP])

    @property
    def leads(self) -> bool:
        """Whether the filter of this watch knows the cores better than the observer, which has not seen the fault."""
        return any(f.code in ("unexplained_heat", "cooling") for f in self.findings)

    @property
    def suspects(self) -> bool:
        """Whether the newest step has enough evidence for a fault that is not reported yet."""
        return self._stands > 0

    @property
    def of_string(self) -> bool:
        """Whether there is a finding other than a thermocouple's."""
        return any(f.code != "thermocouple" for f in self.findings)

    def look(self, w: Weighed, now_ns: int) -> list[Finding]:
        """Judge a step whose evidence has been computed.

        Returns
        -------
        list of Finding
            New findings, and those that have ended (level 0).
        """
        told = self._prove(now_ns) + self._followed(now_ns) + self._left(now_ns) + self._also_heat(now_ns)
        frozen_now = self._stand_still(now_ns)
        told += frozen_now
        if frozen_now or 2 * self.aside.sum() > self.of.at.fitted[self.s].sum():  # then the model is wrong
            self.evidence.forget(self.s)
            return told
        each = w.ln[self.s].max(axis=0) / self.course.doubt[self.s]
        if each.max() < levels.LOAD_DENIED:
            self._stands = 0
        else:
            told += self._weighed(each, w, now_ns)
        if not self.of.running[self.s]:
            return told
        self._standing.known = self.seen.inlet
        for g in self._standing.look(w, each, {g.code for g in self.findings}, now_ns):
            self._tell(g, now_ns)
            told.append(g)
        return told

    def _prove(self, now_ns: int) -> list[Finding]:
        """Check whether heat is proven; then withdraw findings on thermocouples and inlet since its beginning.

        A burning cell warms its neighbours in ways that no number of the model describes.
        """
        heats = self._hot_cells
        if not heats or self._proven:
            self._proven = bool(heats)
            return []
        self._proven, since = proven(self.of, self.s, heats), min(g.since_ns for g in heats)
        taken = ("thermocouple", "inlet") if self._proven else ()
        back = [g for g in self.findings if g.code in taken and g.since_ns >= since]
        for g in back:
            self._end(g, now_ns)
        return back

    def pass_over(self) -> None:
        """Pass a step whose evidence is too small to be judged."""
        self._stands = 0
        self._standing.pass_over()

    def _weighed(self, each: Floats, w: Weighed, now_ns: int) -> list[Finding]:
        kinds = self.evidence.kinds
        E = each + ln_prior(self.evidence, self.course, self.s)
        if self.of.usual.alone[self.s]:
            hold_films(E, w, self.evidence, self.s)
        cools = self.seen.cools and bool(self.course.few[self.s] and self.aside.any())
        E[excluded(kinds, inlet=self.seen.inlet, proven=self._proven, cools=cools)] = -np.inf
        best = int(E.argmax())
        heats = sensors = None
        if each.max() >= SURE:
            heats = many_heats.heats_together(self.evidence, self.course, self.s, self._hot_cells, ~self.aside)
            if not self.hot:  # what thermocouples show of a cell that heats is no fault of theirs
                sensors = many_heats.thermocouples_together(self.evidence, self.course, self.s, ~self.aside)
        many = many_heats.likelier(heats, sensors)
        kind = Kind(int(kinds[best]))
        denied = kind is Kind.LOAD and self.course.denied[self.s]
        enough = levels.LOAD_DENIED if denied else levels.ENOUGH.get(kind, SURE)
        several = many is not None and many.ln >= max(SURE, float(E[best]))
        if each[best] < enough and not several:
            self._stands = 0
            return []
        self._stands += 1
        self._stood_ns = self._stood_ns if self._stands > 1 else now_ns
        held_s = lasted(self._stood_ns, now_ns, self.of.dt) if self._stands > 1 else 0.0
        share = many_heats.shares(E, (heats, sensors))
        if many is None or not several:
            return self._one_weighed(E, w, (share, heats), held_s, now_ns)
        alone = float(share[(kinds == Kind.HEAT) if many is heats else (kinds > Kind.HEAT) & (kinds < Kind.FLOW)].sum())
        poor = bool(self.course.poor[self.s] and (many is sensors or not self.of.calm[self.s]))
        sure = alone >= (levels.ALONE_HEAT if many is heats else levels.ALONE)
        if held_s < HOLD_S or (not sure and held_s < levels.WAIT_S) or (poor and (many is sensors or not sure)):
            return []
        if many_heats.may_be_heats(self.evidence, self.s, many.kind, many.onset, many.ln, heats):
            return []
        accept = self._accept_heats if many is heats else self._accept_sensors
        return accept(many, share, alone, now_ns)

    def _one_weighed(
        self, E: Floats, w: Weighed, beside: tuple[Floats, Together | None], held_s: float, now_ns: int
    ) -> list[Finding]:
        """Judge the single fault that has been the likeliest since `held_s` seconds, `beside` others and several."""
        kinds, place = self.evidence.kinds, self.evidence.place
        share, many = beside
        each = w.ln[self.s].max(axis=0) / self.course.doubt[self.s]
        best = int(E.argmax())
        kind, j = Kind(int(kinds[best])), int(place[best])
        onset = int(w.ln[self.s, :, best].argmax())
        hidden = self._hidden(now_ns)
        slept = bool((w.ln[self.s, hidden, best] > w.ln[self.s, onset, best] - levels.ALIKE).any())
        if slept and kind >= Kind.FLOW and not self.findings:
            self.evidence.forget(self.s)  # a change of all cells during the sleep may come from a drive
            self.of.running[self.s], self._stands = False, 0
            return []
        if may_be_else(self.evidence, self.s, w, onset, best, poor=bool(self.course.poor[self.s])):
            return []
        heat = int(np.where(kinds == Kind.HEAT, E, -np.inf).argmax())
        heats = bool(each[heat] >= SURE), float(E[heat] - E[best])
        if may_be_heat(self.evidence, self.s, w, onset, best, heats, slept=slept):
            best, kind, j = heat, Kind.HEAT, int(place[heat])
            onset = int(w.ln[self.s, :, heat].argmax())
        sensors = (kinds > Kind.HEAT) & (kinds < Kind.FLOW)
        same = kinds == kind if kind is Kind.HEAT or kind >= Kind.FLOW else sensors & (place == j)
        alone = float(share[same].sum())
        # the causes of a change during a sleep cannot be distinguished later either
        waited = held_s >= (HOLD_S if slept else levels.WAIT_S) and each[best] >= SURE
        # under load, no thermocouple is reported with a poor model: heat is not reported instead of it
        loaded = not bool(self.of.calm[self.s])
        waited = waited and not (kind is Kind.HEAT and loaded and self.course.poor[self.s])
        waited = waited and not undecided(self.evidence, self.s, E, best, onset)
        sure = alone >= (levels.ALONE_HEAT if kind is Kind.HEAT else levels.ALONE)
        sure = sure and held_s >= (HOLD_COMMON_S if kind in (Kind.FLOW, Kind.INLET) else HOLD_S)
        if early(self.evidence, self.s, E, best, onset) or not (sure or waited):
            return []
        own = kind < Kind.FLOW and not self._proven
        if (own and shown_by(self.of, self.s, (kind, j), self.still * ~self.aside)) or many_heats.may_be_heats(
            self.evidence, self.s, kind, onset, float(E[best]), many
        ):
            return []
        return self._accept(best, onset, w, share, alone, now_ns)

    def _hidden(self, now_ns: int) -> Bools:
        """Return which onsets are before the end of the last sleep."""
        awake_s = np.inf if self.woke_ns is None else lasted(self.woke_ns, now_ns, self.of.dt)
        return np.asarray(self.evidence.ages(self.s) > awake_s)

    def _accept(self, fault: int, onset: int, w: Weighed, share: Floats, sure: float, now_ns: int) -> list[Finding]:
        """Accept a fault: the states are shifted by its effect, and the evidence starts again from zero."""
        s, f = self.s, self.of
        kind, place = Kind(int(self.evidence.kinds[fault])), int(self.evidence.place[fault])
        amplitude, var = float(w.amplitude[s, onset, fault]), float(w.var[s, onset, fault])
        if self._proven and kind is not Kind.HEAT:
            self.evidence.forget(s)
            f.open_heat(s, int(np.flatnonzero(f.at.seen[s] & (f.at.told[s] == f.at.sensors[s, place]))[0]), 0.0)
            return []  # it follows its cell, and no balance describes the cell
        told = [g for g in self.findings if g.code == "thermocouple" and not self.aside[g.place]]
        again = known(self.evidence, s, w, place, told) if kind is Kind.HEAT and not self._proven else None
        if again is not None:
            return self._accept(again, int(w.ln[s, :, again].argmax()), w, share, sure, now_ns)
        age_s = float(self.evidence.ages(s)[onset])
        sizes, bias = {place: amplitude}, f.z[s, f.at.bias].copy()
        slips = kind is Kind.JUMP and amplitude < 0.0 and heats_at(self.findings, int(f.at.sensors[s, place]))
        if kind is Kind.HEAT:
            young = self.seen.age_s < levels.YOUNG_S and not (self.hot or f.usual.alone[s])
            if young and self.course.unlike[s]:  # the state was found with this heat
                f.unlearn(s)
            sizes = share_out(f, self.evidence, self.course, s, w, fault)
        else:
            f.move(s, self.evidence.moved(s, onset, fault), amplitude, var)
        self.evidence.forget(s)
        self._stands = 0
        new = Finding("", None, 1, now_ns - round(age_s * 1e9), kind=kind, place=place, size=amplitude, sure=sure)
        new.others, new.places = others(self.evidence, s, share, new), tuple(sizes)
        if kind is Kind.FLOW:
            self._standing.flowed_ns = now_ns
        if kind in (Kind.FLOW, Kind.LOAD, Kind.STREAM):
            return []  # `Standing` judges the states of heat and films in every step; a step of the flow is no fault
        if kind is Kind.HEAT:
            tells = self._heats(new, sizes)
        else:
            tells = self._is_off(new) if kind is Kind.INLET else self._fails(new)
        if not tells:
            return []
        if slips:  # more will follow; what it reads is compared with what it read before
            self.aside[place], f.z[s, f.at.bias] = True, bias
        self._tell(new, now_ns)
        return [new]

    def _accept_heats(self, many: Together, share: Floats, sure: float, now_ns: int) -> list[Finding]:
        """Accept heat in several cells: a finding for each of them that is large enough."""
        s, f, e = self.s, self.of, self.evidence
        age_s = float(e.ages(s)[many.onset])
        weighed = [many_heats.given(e, s, many, j) for j in many.faults]
        if self.seen.age_s < levels.YOUNG_S and not self.hot and self.course.unlike[s]:
            f.unlearn(s)
        share[list(many.faults)] = 0.0  # the heat in one of the cells is no other cause of that in the next
        told = []
        for fault, w in zip(many.faults, weighed, strict=True):
            sizes = share_out(f, e, self.course, s, w, fault)
            size = float(w.amplitude[s, many.onset, fault])
            new = Finding("", None, 1, now_ns - round(age_s * 1e9), place=int(e.place[fault]), size=size, sure=sure)
            new.others, new.places = others(e, s, share, new), tuple(sizes)
            if self._heats(new, sizes):
                self.findings.append(new)
                told.append(new)
        e.forget(s)
        self._stands = 0
        for new in told:
            self._write(new, now_ns)
        return told

    def _accept_sensors(self, many: Together, share: Floats, sure: float, now_ns: int) -> list[Finding]:
        """Accept a fault that several thermocouples have."""
        since, told = now_ns - round(float(self.evidence.ages(self.s)[many.onset]) * 1e9), []
        share[list(many.faults)] = 0.0
        for fault, size in zip(
            many.faults, many_heats.move_together(self.of, self.evidence, self.s, many).tolist(), strict=True
        ):
            place = int(self.evidence.place[fault])
            new = Finding("", None, 1, since, kind=many.kind, place=place, size=size, sure=sure)
            new.others = others(self.evidence, self.s, share, new)
            if self._fails(new):
                self._tell(new, now_ns)
                told.append(new)
        self.evidence.forget(self.s)
        self._stands = 0
        return told

    def _also_heat(self, now_ns: int) -> list[Finding]:
        """Name the cells beside one with heat that heat, too, by readings of their own."""
        heats = self._hot_cells
        fire = self.burning or any(g.hottest > BURNT_C for g in heats)  # heats its neighbours from outside
        there = many_heats.also_heats(self.of, self.s, heats, ~self.aside) if heats and not fire else {}
        self._also = {j: self._also.get(j, now_ns) for j in there}
        told = []
        for j, since in self._also.items():
            if held(since, now_ns, self.of.dt, many_heats.ALSO_S):
                for g in heats:
                    g.places = tuple(k for k in g.places if k != j)
                cell = int(self.of.at.told[self.s, j]) + 1
                new = Finding("unexplained_heat", cell, 2, since, place=j, places=(j,), size=there[j])
                self._tell(new, now_ns)
                told.append(new)
        return told

    def _heats(self, new: Finding, sizes: Mapping[int, float]) -> bool:
        """Make a finding of accepted heat, W by cell, if it is large enough and not reported already."""
        s, f, place = self.s, self.of, new.place
        cell = int(f.at.told[s, place])
        load, rest = float(self.course.load[s, cell]), LEAST_RATE * float(f.usual.C[s, place])
        negative = f.usual.alone[s] and f.z[s, f.at.load] < -1.0  # the model would need a current that cools
        unsure = self.course.constant_inlet[s] or negative
        if new.size < max(rest, (levels.ALONE_SHARE if self.course.few[s] else levels.LEAST_SHARE) * load) or (
            unsure and load > rest
        ):
            return False
        if float(f.z[s, f.at.heat.start + np.array(new.places)].max()) <= 0.0:
            return False  # by the states the cell is cooled, not heated
        for j, watts in sizes.items():
            f.open_heat(s, j, watts)
        new.code, new.cell, new.level = "unexplained_heat", cell + 1, 2
        return not any(g.code == new.code and place in g.places for g in self.findings)

    def _fails(self, new: Finding) -> bool:
        """Make a finding of a thermocouple's fault, if it is large enough; all but a jump set it aside."""
        s, place = self.s, new.place
        new.code, new.cell = "thermocouple", int(self.of.at.sensors[s, place]) + 1
        if new.kind is Kind.JUMP:
            if abs(new.size) < max(levels.LEAST_JUMP, levels.COARSE * float(self.course.fine[s, place])):
                return False
        else:
            self.aside[place] = True
        self.findings = [g for g in self.findings if (g.code, g.cell) != (new.code, new.cell)]
        return True

    def _is_off(self, new: Finding) -> bool:
        """Make a finding of an inlet that is frozen, or that has a large offset."""
        s, f, at, c = self.s, self.of, self.of.at, self.course
        off, sd = float(f.z[s, at.inlet]), sqrt(float(f.P[s, at.inlet, at.inlet]))
        still = c.frozen[s] * f.dt >= FROZEN_S and not c.constant_inlet[s] and abs(new.size) > FROZEN_K
        new.code, new.size = "inlet", off
        far = abs(off) > INLET_OFF and abs(off) > INLET_SURE * sd
        return bool(still or far) and not any(g.code == new.code for g in self.findings)

    def _left(self, now_ns: int) -> list[Finding]:
        """Set thermocouples aside that have left a cell while it heats."""
        told, heats = [], self._hot_cells
        for g in heats:
            place = left_by(self.of, self.s, g, ~self.aside)
            g.colder_ns = None if place is None else g.colder_ns or now_ns
            fire = self.burning or any(h.hottest > BURNT_C for h in heats)
            if place is None or fire or not held(g.colder_ns, now_ns, self.of.dt, COLDER_S):
                continue
            new = Finding("", None, 1, g.colder_ns or now_ns, kind=Kind.LAG, place=place, size=1.0)
            self._fails(new)
            as_found(self.of, self.s, g)
            self.evidence.forget(self.s)
            self._tell(new, now_ns)
            told.append(new)
        return told

    def _stand_still(self, now_ns: int) -> list[Finding]:
        """Set thermocouples aside that are frozen."""
        told, still = [], self.still * ~self.aside
        for place in frozen(self.course.fine[self.s], still, self._residual, self._residual_sd).tolist():
            new = Finding("", None, 1, now_ns - round(still[place] * 1e9), kind=Kind.LAG, place=place, size=1.0)
            self._fails(new)
            self.evidence.forget(self.s)
            self._tell(new, now_ns)
            told.append(new)
        return told

    def _followed(self, now_ns: int) -> list[Finding]:
        """Update the findings; return those that have ended."""
        told, reads = [], self.course.reads_all_along(self.s)
        if not any(g.code == "inlet" for g in self.findings):
            self._inlet_C = reads
        elif self.seen.inlet and reads != self._inlet_C:
            self._inlet_C = nan  # it has moved since the finding: it is not frozen any more
        for g in list(self.findings):
            over = self._over(g, now_ns)
            if g.low_ns is None:  # a finding that is being contradicted keeps its last sentence
                self._write(g, now_ns)
            if over:
                self._end(g, now_ns)
                told.append(g)
        return told

    def _over(self, g: Finding, now_ns: int) -> bool:
        """Return whether the readings have contradicted a finding for long enough."""
        s, f, at = self.s, self.of, self.of.at
        if g.code == "unexplained_heat":
            low = g.colder_ns is None and has_ended(f, s, g, self.seen.gaps, self._hot_cells, ~self.aside)
            failed = failed_since(self.findings, g, len(self.aside))
            seen = not (self._proven or failed.any()) or watched(f, s, g.place, self.seen.read & ~failed)
            return self._quiet(g, now_ns, low and seen and not self.burning, ENDED_S)
        if g.kind is Kind.JUMP and not self.aside[g.place]:
            return self._quiet(g, now_ns, abs(float(f.z[s, at.bias.start + g.place])) < levels.BACK_JUMP, 60.0)
        if g.code == "thermocouple" and g.still_s and self.aside[g.place]:
            state = (float(x[g.place]) for x in (self.still, self._residual, self._residual_sd))
            return self._quiet(g, now_ns, thawed(*state), THAWED_S)
        if g.code == "thermocouple":
            return self._quiet(g, now_ns, not self.aside[g.place] or self._near(g), levels.QUIET_S)
        if g.code == "cooling":
            return self._quiet(g, now_ns, self._grown() < COOLING_BACK, 120.0)
        if g.code == "inlet":
            off, sd = abs(float(f.z[s, at.inlet])), sqrt(float(f.P[s, at.inlet, at.inlet]))
            right = off < 1.0 + sd and bool(self.course.frozen[s] * f.dt < FROZEN_S) and isnan(self._inlet_C)
            return self._quiet(g, now_ns, right and self.seen.inlet, 300.0)
        return self._quiet(g, now_ns, float(f.made()[0][s]) > MISSING_BACK, 60.0)

    def _near(self, g: Finding) -> bool:
        """Return whether a thermocouple set aside reads its prediction, and not the value of its fault."""
        off, sd = float(self._residual[g.place]), float(self._residual_sd[g.place])
        would = g.size * float(self._shows[g.kind][g.place]) if g.kind in self._shows else np.inf
        if g.low_ns is not None:
            g.low_ns += round(max(0.0, 1.0 - (would / sd) ** 2) * self.of.dt * 1e9)  # an invisible fault says little
        return abs(off) < levels.QUIET_SD * sd and (abs(would) < sd or abs(off) < abs(off - would))

    def _end(self, g: Finding, now_ns: int) -> None:
        self.findings.remove(g)
        if g.code == "unexplained_heat":
            for j in g.places if self.hot else np.flatnonzero(self.of.open[self.s]).tolist():
                self.of.close_heat(self.s, j)
            self.evidence.forget(self.s)
        elif g.code == "thermocouple" and self.aside[g.place]:
            self.aside[g.place] = False
            self.of.doubt_offset(self.s, g.place, float(self._residual[g.place]))
            self.evidence.forget(self.s)
        elif g.code == "cooling":
            self.course.cooling[self.s] = False
        g.level, g.text = 0, sentence(g, self.of.at.cells, now_ns, over=True)

    def take_up(self, g: Finding, now_ns: int) -> None:
        """Restore heat that was found before a restart at `now_ns`."""
        for j in g.places:
            self.of.open_heat(self.s, j, g.size)
        self.findings.append(g)
        self._write(g, now_ns)

    def residuals(self, value: Floats, sd: Floats, shows: Mapping[Kind, Floats]) -> None:
        """Take the deviations (m,), K, of the thermocouples from their predictions, and those of a whole fault."""
        self._residual, self._residual_sd, self._shows = value, sd, shows

    def _quiet(self, g: Finding, now_ns: int, low: bool, wait_s: float) -> bool:
        g.low_ns = (now_ns if g.low_ns is None else g.low_ns) if low else None
        return held(g.low_ns, now_ns, self.of.dt, wait_s)

    def _tell(self, g: Finding, now_ns: int) -> None:
        self.findings.append(g)
        self._write(g, now_ns)

    def _grown(self) -> float:
        """Growth of R_u against its usual value."""
        return float(self.course.grown(self.of)[self.s])

    def _write(self, g: Finding, now_ns: int) -> None:
        s, f, at = self.s, self.of, self.of.at
        if g.kind is Kind.FLOW:
            g.size = self._grown()
        elif g.kind is Kind.INLET and not self.seen.inlet:
            return
        elif g.kind is Kind.INLET:
            g.size = float(f.z[s, at.inlet])
            g.still_s = float(self.course.frozen[s] * f.dt) if self.course.stuck[s] else 0.0
        elif g.kind is Kind.LOAD:
            g.size = min(g.size, max(0.0, float(f.made()[0][s])))
        elif g.kind is Kind.HEAT:
            g.heat, g.heat_sd = heat_there(f, s, g.place, g.places)
        if g.kind is Kind.HEAT or (g.code == "thermocouple" and self.aside[g.place]):
            note_still(f, s, g, self.still)
        g.text = sentence(g, at.cells, now_ns)
