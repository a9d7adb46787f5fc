"""What the evidence of a string says: which fault, since when, how sure, what else it could be, and what to do."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import exp, sqrt

import numpy as np

from bms_gateway.health.heat.course import (
    COOLING,
    COOLING_BACK,
    COOLING_GRAVE,
    FLOW_GRAVE,
    FLOW_SURE,
    FROZEN_K,
    FROZEN_S,
    MISSING_BACK,
    SOUND_INLET,
    Course,
    missing,
)
from bms_gateway.health.heat.fault_evidence import OLDEST_READ, ONSETS, Evidence, Kind, Weighed
from bms_gateway.health.heat.filter import HeatFilter
from bms_gateway.health.heat.finding import Finding
from bms_gateway.health.heat.layout import Bools
from bms_gateway.health.heat.proven import known, proven, watched
from bms_gateway.health.heat.sentences import others, sentence
from bms_gateway.thermal import Floats

SURE = 14.0
"""ln evidence from which heat is believed: some 5 sd, with a few dozen faults and onsets looked at each step."""
ENOUGH = {Kind.SLOPE: 8.0, Kind.FLOW: 9.0, Kind.INLET: 9.0, Kind.LOAD: 9.0}
"""The same where a mistake costs less, or where what follows is looked at again before it is told."""
ALONE, ALONE_HEAT = 0.95, 0.998
"""Share of all the evidence that one cause must have to be told at once: a thermocouple that comes off while its cell
cools looks like heat for a minute."""
WAIT_S = 180.0
"""What is sure to be something, but may be one of several, is told by its likeliest cause after so long."""
UNTOLD = 3.0
"""ln: a cell that warmed in a sleep looks like a thermocouple that jumped; heat, the worse of the two, is told
unless it is by so much less likely. Before enough frames show its course, this holds of a drift as well."""
LIKE_HEAT, MOST_STOPPED, RARER = 1.5, 0.85, 4.0
"""A lone thermocouple reads much the same of heat and of films that are lost. Fans and pumps stop more often than cells
short: heat is rarer by so much (ln) unless its evidence is so many times that of films. A fan that stands takes no more
than the second share."""
ALIKE = 1.0  # ln: onsets between which evidence does not choose
HOLD_S, HOLD_COMMON_S = 20.0, 60.0
"""One step's surprise is no fault: what is told has been the likeliest for as long."""
USUAL = {Kind.FLOW: 4.0, Kind.INLET: 0.0, Kind.LOAD: 2.0, Kind.SLOPE: -2.0, Kind.LAG: 3.0}
"""ln of how much more often this changes in sound packs than a fault comes."""
LEAST_RATE, LEAST_SHARE, ALONE_SHARE = 1e-3, 0.1, 3.0
"""Heat below this rate of the cell's capacity, K/s, or share of the heat by its current, is no fault. The last share
holds where no other cells tell what the current makes: a cell that is nearly empty or cold seems to make several times
its usual heat. Where nobody measures the coolant, only heat at rest is a fault: cooling that is switched looks like
heat."""
SIZE_SD = 0.2
"""Of new heat, relative: its first half minute shows how fast heat reaches the surface, by C_s and R_c, as much as how
much it is."""
GROUP, TEMPERED = 2, 8.0
"""Heat in a cell may sit in one so far away that shares a sensor with it; and by what evidence between these counts."""
LEAST_JUMP, BACK_JUMP = 0.7, 0.4
"""K: a thermocouple that jumps by less is not told, and one that is off by less again is over."""
COARSE = 2.5  # steps of its own readings that a thermocouple jumps by at least
FLOWED_S = 1800.0
"""After a change of the films has been believed they may be told to be worse for so long: slow changes are ageing's."""
INLET_OFF, INLET_SURE = 3.0, 4.0  # K and sd from which the inlet is wrong whatever its sensor does
MORE = 0.5  # share of heat more than the current's from which on none of it can be missing
SUSPECT = 5.0
"""ln evidence from which a change of the heat that is the likeliest of all is counted before it is believed."""
ENDED_SD, ENDED_S = 2.0, 300.0
"""Heat is over if it is below so many sd for so long,"""
ENDED_SHARE = 0.5
"""and below this share of what was found."""
QUIET_SD, QUIET_S = 3.0, 900.0
"""A thermocouple set aside that is within this of its prediction for so long is used again."""


@dataclass(slots=True)
class Verdict:
    """Verdict on string `s` of a filter.

    Attributes
    ----------
    findings : list of Finding
    aside : ndarray of bool (m,)
        Thermocouples that are not believed.
    woke_ns : int or None
        When the string last woke from a sleep.
    read : ndarray of bool (m,)
        Thermocouples that were used in the last step.
    cools : bool
        Whether no current flows and all thermocouples fall: few cannot tell heat from that of the drive then.
    too_hot : bool
        Whether an alarm of a limit or of a runaway is on in the string: its heat is not over.
    """

    s: int
    of: HeatFilter
    evidence: Evidence
    course: Course
    aside: np.ndarray[tuple[int], np.dtype[np.bool_]] = field(init=False)
    findings: list[Finding] = field(default_factory=list)
    woke_ns: int | None = None
    read: Bools = field(init=False)
    cools: bool = False
    too_hot: bool = False
    _proven: bool = False
    _stands: int = 0
    _stood_ns: int = 0
    _slow_ns: int | None = None
    _flowed_ns: int | None = None
    _residual: Floats = field(default_factory=lambda: np.zeros(0))
    _residual_sd: Floats = field(default_factory=lambda: np.zeros(0))
    _shows: Mapping[Kind, Floats] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.aside = np.zeros(self.of.at.sensed, np.bool_)
        self.read = np.ones(self.of.at.sensed, np.bool_)

    @property
    def hot(self) -> bool:
        """Whether a cell heats by itself."""
        return any(f.code == "unexplained_heat" for f in self.findings)

    @property
    def leads(self) -> bool:
        """Whether the filter of this watch knows the cores better than an observer to which what was found is news."""
        return any(f.code in ("unexplained_heat", "cooling") for f in self.findings)

    @property
    def suspects(self) -> bool:
        """Whether the last step that was weighed speaks for a fault that is not believed yet."""
        return self._stands > 0

    @property
    def of_string(self) -> bool:
        """Whether something is wrong beside thermocouples."""
        return any(f.code != "thermocouple" for f in self.findings)

    def look(self, w: Weighed, now_ns: int) -> list[Finding]:
        """Take in a step that has been weighed.

        Returns
        -------
        list of Finding
            What has come, or is over (level 0).
        """
        told = self._prove(now_ns) + self._followed(now_ns)
        if 2 * self.aside.sum() > self.of.at.fitted[self.s].sum():  # most thermocouples are not wrong: the model is
            self.evidence.forget(self.s)
            return told
        each = w.ln[self.s].max(axis=0) / self.course.doubt[self.s]
        if each.max() < min(ENOUGH.values()):
            self._stands = 0
        else:
            told += self._weighed(each, w, now_ns)
        return told + (self._standing(w, each, now_ns) if self.of.running[self.s] else [])

    def _prove(self, now_ns: int) -> list[Finding]:
        """See whether heat is proven; then what thermocouples and inlet were told to be since it began is taken back.

        A cell that burns warms its neighbours in ways that no number of the model has.
        """
        heats = [g for g in self.findings if g.code == "unexplained_heat"]
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
        """Take in a step in which nothing was of note."""
        self._stands, self._slow_ns = 0, None

    def _weighed(self, each: Floats, w: Weighed, now_ns: int) -> list[Finding]:
        kinds, place = self.evidence.kinds, self.evidence.place
        E = each + self.usual()
        if self.of.alone[self.s]:
            self._hold_films(E, w)
        if self._proven:
            E[kinds >= Kind.FLOW] = -np.inf
        elif self.cools and self.course.few[self.s]:
            E[kinds == Kind.HEAT] = -np.inf
        best = int(E.argmax())
        kind, j = Kind(int(kinds[best])), int(place[best])
        if each[best] < ENOUGH.get(kind, SURE):
            self._stands = 0
            return []
        self._stands += 1
        self._stood_ns = self._stood_ns if self._stands > 1 else now_ns
        held = self._lasted(self._stood_ns, now_ns) if self._stands > 1 else 0.0
        onset = int(w.ln[self.s, :, best].argmax())
        hidden = self._hidden(now_ns)
        slept = bool((w.ln[self.s, hidden, best] > w.ln[self.s, onset, best] - ALIKE).any())
        if slept and kind >= Kind.FLOW and not self.findings:
            self.evidence.forget(self.s)  # what came over all cells while nobody looked may have been a drive
            self.of.running[self.s], self._stands = False, 0
            return []
        if kind in (Kind.JUMP, Kind.SLOPE) and w.amplitude[self.s, onset, best] > 0.0:
            heat = int(np.where(kinds == Kind.HEAT, E, -np.inf).argmax())
            if kind is Kind.JUMP:
                unclear = slept and E[heat] > E[best] - UNTOLD
            else:
                unclear = self.evidence.reads(onset) < OLDEST_READ and each[heat] >= SURE
            if unclear:
                best, kind, j = heat, Kind.HEAT, int(place[heat])
                onset = int(w.ln[self.s, :, heat].argmax())
        share = np.exp(E - E.max())
        share /= share.sum() + exp(-E.max())
        sensors = (kinds > Kind.HEAT) & (kinds < Kind.FLOW)
        same = kinds == kind if kind is Kind.HEAT or kind >= Kind.FLOW else sensors & (place == j)
        alone = float(share[same].sum())
        # what a sleep has hidden looks the same however long one waits
        waited = held >= (HOLD_S if slept else WAIT_S) and each[best] >= SURE
        if (
            alone < (ALONE_HEAT if kind is Kind.HEAT else ALONE)
            or held < (HOLD_COMMON_S if kind >= Kind.FLOW else HOLD_S)
        ) and not waited:
            return []
        return self._accept(best, onset, w, share, alone, now_ns)

    def _hold_films(self, E: Floats, w: Weighed) -> None:
        """Hold the evidence (H,) of heat and of lost films in a string with few thermocouples against each other."""
        kinds = self.evidence.kinds
        heat, flow = kinds == Kind.HEAT, int(np.flatnonzero(kinds == Kind.FLOW)[0])
        since = int(w.ln[self.s, :, flow].argmax())
        lost = float(w.amplitude[self.s, since, flow])
        rest = lost * float(self.evidence.moved(self.s, since, flow)[self.of.at.flow])  # not in the numbers yet
        if self.of.calm[self.s] and rest + float(self.of.z[self.s, self.of.at.flow]) > MOST_STOPPED:
            E[flow] = -np.inf
        elif 0.0 < lost < MOST_STOPPED and E[heat].max() < LIKE_HEAT * E[flow]:
            E[heat] = np.minimum(E[heat], E[flow] - RARER)

    def _hidden(self, now_ns: int) -> Bools:
        """Tell which onsets lie in or before the sleep that ended last."""
        if self.woke_ns is None:
            return np.zeros(ONSETS, np.bool_)
        return self.evidence.ages(self.s) > self._lasted(self.woke_ns, now_ns)

    def usual(self) -> Floats:
        """Tell how much likelier each fault (H,) is than others before any evidence, ln."""
        usual = np.array([USUAL.get(Kind(k), 0.0) for k in self.evidence.kinds])
        c, s = self.course, self.s
        if not (c.frozen[s] * self.of.dt >= FROZEN_S or c.constant_inlet[s] or c.leapt[s] > 0):
            usual[self.evidence.kinds == Kind.INLET] = SOUND_INLET
        return usual

    def _accept(
        self,
        fault: int,
        onset: int,
        w: Weighed,
        share: Floats,
        sure: float,
        now_ns: int,
    ) -> list[Finding]:
        """Believe a fault: the numbers move by it, and the search begins anew."""
        s, f = self.s, self.of
        kind, place = Kind(int(self.evidence.kinds[fault])), int(self.evidence.place[fault])
        amplitude, var = float(w.amplitude[s, onset, fault]), float(w.var[s, onset, fault])
        if self._proven and kind is not Kind.HEAT:
            self.evidence.forget(s)
            f.open_heat(s, int(np.flatnonzero(f.at.seen[s] & (f.at.told[s] == f.at.sensors[s, place]))[0]), 0.0)
            return []  # it follows its cell, and that cell no balance
        told = [g for g in self.findings if g.code == "thermocouple" and not self.aside[g.place]]
        again = known(self.evidence, s, w, place, told) if kind is Kind.HEAT and not self._proven else None
        if again is not None:
            return self._accept(again, int(w.ln[s, :, again].argmax()), w, share, sure, now_ns)
        age_s = float(self.evidence.ages(s)[onset])
        places = self._share_out(fault, w) if kind is Kind.HEAT else (place,)
        if kind is not Kind.HEAT:
            f.move(s, self.evidence.moved(s, onset, fault), amplitude, var)
        self.evidence.forget(s)
        self._stands = 0
        new = Finding("", None, 1, now_ns - round(age_s * 1e9), kind=kind, place=place, size=amplitude, sure=sure)
        new.others, new.places = others(self.evidence, s, share, new), places
        if kind is Kind.FLOW:
            self._flowed_ns = now_ns
        tells = {Kind.HEAT: self._heats, Kind.INLET: self._is_off}.get(kind, self._fails)
        if kind in (Kind.FLOW, Kind.LOAD) or not tells(new):
            return []  # what heat and films have become is looked at in every step
        self.findings.append(new)
        self._write(new, now_ns)
        return [new]

    def _heats(self, new: Finding) -> bool:
        """Take heat that is believed for a fault, if it is worth one and not told already."""
        s, f, place = self.s, self.of, new.place
        cell = int(f.at.told[s, place])
        load, rest = float(self.course.load[s, cell]), LEAST_RATE * float(f.C[s, place])
        unsure = self.course.constant_inlet[s] or (f.alone[s] and f.z[s, f.at.load] < -1.0)  # a model that needs cold
        if new.size < max(rest, (ALONE_SHARE if self.course.few[s] else LEAST_SHARE) * load) or (
            unsure and load > rest
        ):
            return False
        if float(f.z[s, f.at.heat.start + np.array(new.places)].max()) <= 0.0:
            return False  # what the numbers make of it is cold
        for j in new.places:
            f.open_heat(s, j, new.size)
        new.code, new.cell, new.level = "unexplained_heat", cell + 1, 2
        return not any(g.code == new.code and place in g.places for g in self.findings)

    def _fails(self, new: Finding) -> bool:
        """Take a fault of a thermocouple, if it is worth one; what no offset mends sets it aside."""
        s, place = self.s, new.place
        new.code, new.cell = "thermocouple", int(self.of.at.sensors[s, place]) + 1
        if new.kind is Kind.JUMP:
            if abs(new.size) < max(LEAST_JUMP, COARSE * float(self.course.fine[s, place])):
                return False
        else:
            self.aside[place] = True
        self.findings = [g for g in self.findings if (g.code, g.cell) != (new.code, new.cell)]
        return True

    def _is_off(self, new: Finding) -> bool:
        """Take an offset of the inlet for a fault, if it is frozen or far off."""
        s, f, at, c = self.s, self.of, self.of.at, self.course
        off, sd = float(f.z[s, at.inlet]), sqrt(float(f.P[s, at.inlet, at.inlet]))
        still = c.frozen[s] * f.dt >= FROZEN_S and not c.constant_inlet[s] and abs(new.size) > FROZEN_K
        new.code, new.size = "inlet", off
        far = abs(off) > INLET_OFF and abs(off) > INLET_SURE * sd
        return bool(still or far) and not any(g.code == new.code for g in self.findings)

    def _share_out(self, fault: int, w: Weighed) -> tuple[int, ...]:
        """Move the numbers by heat that sits in a cell or one beside: which, one sensor hardly tells.

        The cells of the group are merged by their moments. How evidence falls between them hangs on a conduction that
        is known to some tens of per cent, so it counts by a part only.

        Returns
        -------
        tuple of int
            Numbers of the cells, of those told of, that it may sit in.
        """
        s, f, e = self.s, self.of, self.evidence
        cells, best = f.at.told[s], int(f.at.told[s, e.place[fault]])
        ln = w.ln[s].max(axis=0)
        group = [
            j
            for j in np.flatnonzero(e.kinds == Kind.HEAT).tolist()
            if f.at.seen[s, e.place[j]] and abs(int(cells[e.place[j]]) - best) <= GROUP and np.isfinite(ln[j])
        ]
        chance = np.exp((ln[group] - ln[fault]) / TEMPERED)
        chance /= chance.sum()
        onsets = [int(w.ln[s, :, j].argmax()) for j in group]
        along = np.array([e.moved(s, o, j) for o, j in zip(onsets, group, strict=True)])
        amplitude = np.array([w.amplitude[s, o, j] for o, j in zip(onsets, group, strict=True)])
        var = np.array([w.var[s, o, j] for o, j in zip(onsets, group, strict=True)])
        moves = along * amplitude[:, None]
        mean = chance @ moves
        off = moves - mean
        f.z[s] += mean
        f.P[s] += (off.T * chance) @ off + (along.T * (chance * var)) @ along
        h = f.at.heat.start + e.place[group]
        f.P[s, h, h] += chance * np.square(SIZE_SD * amplitude)
        if f.alone[s]:  # nothing else has changed, however far a lone thermocouple took it
            f.z[s, f.at.common] = e.before(s, int(w.ln[s, :, fault].argmax()))
            f.z[s, f.at.flow] = self.course.film[s]  # of the last hour: slow heat takes it along before it is told
        return tuple(int(e.place[j]) for j, c in zip(group, chance.tolist(), strict=True) if c > 0.02)

    def _followed(self, now_ns: int) -> list[Finding]:
        """See what has become of what was found."""
        told = []
        for g in list(self.findings):
            over = self._over(g, now_ns)
            if g.low_ns is None:  # what is contradicted and may be over is told as it was believed last
                self._write(g, now_ns)
            if over:
                self._end(g, now_ns)
                told.append(g)
        return told

    def _over(self, g: Finding, now_ns: int) -> bool:
        """Tell whether a finding has been contradicted for long enough."""
        s, f, at = self.s, self.of, self.of.at
        if g.code == "unexplained_heat":
            h = at.heat.start + np.array(g.places)
            heat, P = f.z[s, h], f.P[s][np.ix_(h, h)]
            chance = float(heat @ np.linalg.solve(P, heat)) < ENDED_SD**2 + len(h) - 1
            most = float(heat.sum()) + sqrt(max(0.0, float(P.sum())))
            chance = chance and most < ENDED_SHARE * g.size  # not for want of knowledge alone
            cold = float(heat.sum()) < LEAST_RATE * float(f.C[s, g.place])
            seen = watched(f, s, g.place, self.read) and not self.too_hot
            return self._quiet(g, now_ns, (chance or cold) and seen, ENDED_S)
        if g.kind is Kind.JUMP:
            return self._quiet(g, now_ns, abs(float(f.z[s, at.bias.start + g.place])) < BACK_JUMP, 60.0)
        if g.code == "thermocouple":
            return self._quiet(g, now_ns, not self.aside[g.place] or self._near(g), QUIET_S)
        if g.code == "cooling":
            return self._quiet(g, now_ns, self._grown() < COOLING_BACK, 120.0)
        if g.code == "inlet":
            off, sd = abs(float(f.z[s, at.inlet])), sqrt(float(f.P[s, at.inlet, at.inlet]))
            return self._quiet(g, now_ns, off < 1.0 + sd and bool(self.course.frozen[s] * f.dt < FROZEN_S), 300.0)
        return self._quiet(g, now_ns, float(f.made()[0][s]) > MISSING_BACK, 60.0)

    def _near(self, g: Finding) -> bool:
        """Tell whether a thermocouple set aside reads what it should, and not what its fault makes of it."""
        off, sd = float(self._residual[g.place]), float(self._residual_sd[g.place])
        would = g.size * float(self._shows[g.kind][g.place]) if g.kind in self._shows else np.inf
        if g.low_ns is not None:
            g.low_ns += round(max(0.0, 1.0 - (would / sd) ** 2) * self.of.dt * 1e9)  # what does not show says little
        return abs(off) < QUIET_SD * sd and (abs(would) < sd or abs(off) < abs(off - would))

    def _end(self, g: Finding, now_ns: int) -> None:
        self.findings.remove(g)
        if g.code == "unexplained_heat":
            for j in g.places if self.hot else np.flatnonzero(self.of.open[self.s]).tolist():
                self.of.close_heat(self.s, j)
            self.evidence.forget(self.s)
        elif g.code == "thermocouple" and self.aside[g.place]:
            self.aside[g.place] = False
            self.evidence.forget(self.s)
        elif g.code == "cooling":
            self.course.cooling[self.s] = False
        g.level, g.text = 0, sentence(g, self.of.at.cells, now_ns, over=True)

    def take_up(self, g: Finding, now_ns: int) -> None:
        """Take up heat that was found before a restart at `now_ns`."""
        for j in g.places:
            self.of.open_heat(self.s, j, g.size)
        self.findings.append(g)
        self._write(g, now_ns)

    def residuals(self, value: Floats, sd: Floats, shows: Mapping[Kind, Floats]) -> None:
        """Take what the thermocouples (m,) are off their prediction, used or not, K; and would be by a whole fault."""
        self._residual, self._residual_sd, self._shows = value, sd, shows

    def _quiet(self, g: Finding, now_ns: int, low: bool, wait_s: float) -> bool:
        g.low_ns = (now_ns if g.low_ns is None else g.low_ns) if low else None
        return g.low_ns is not None and self._lasted(g.low_ns, now_ns) >= wait_s

    def _lasted(self, since_ns: int, now_ns: int) -> float:
        """Seconds from the begin of the step that ended at `since_ns`: frames may come rarely."""
        return (now_ns - since_ns) * 1e-9 + self.of.dt

    def _standing(self, w: Weighed, each: Floats, now_ns: int) -> list[Finding]:
        """Tell what the numbers themselves say, however they came about."""
        s, f, at = self.s, self.of, self.of.at
        codes = {g.code for g in self.findings}
        share, var = (float(x[s]) for x in f.made())
        best = int(each.argmax())
        if self.evidence.kinds[best] == Kind.LOAD and each[best] > SUSPECT:
            onset = int(w.ln[s, :, best].argmax())
            moved = self.evidence.moved(s, onset, best)
            share += float(w.amplitude[s, onset, best]) * float(moved[at.load] + moved[at.brisk])
            var += float(w.var[s, onset, best])
        new = []
        sound = each[best] < SUSPECT or self.evidence.kinds[best] == Kind.LOAD
        warms = bool(self.course.warms[s]) and sound and "cooling" not in codes
        warms = warms and float(f.z[s, at.load]) < MORE  # numbers that say both know neither
        if "missing_heat" not in codes and warms and missing(share, sqrt(var)):
            new.append(Finding("missing_heat", None, 2, now_ns, kind=Kind.LOAD, size=max(0.0, share)))
        u, u_sd = float(f.z[s, at.flow]), sqrt(float(f.P[s, at.flow, at.flow]))
        grown = self._grown()
        own = (self._stands > 0 and self.evidence.kinds[best] < Kind.FLOW) or self.hot
        if "cooling" not in codes:
            slower = grown > COOLING and u - self.course.film[s] > FLOW_SURE * u_sd and not own
            flowed = self._flowed_ns is not None and self._lasted(self._flowed_ns, now_ns) < FLOWED_S
            grave = grown > COOLING_GRAVE and u - self.course.film[s] > FLOW_GRAVE * u_sd
            slower = slower and (flowed or grave)
            self._slow_ns = (now_ns if self._slow_ns is None else self._slow_ns) if slower else None
            hold = HOLD_S if flowed else HOLD_COMMON_S
            if self._slow_ns is not None and self._lasted(self._slow_ns, now_ns) >= hold:
                level = 2 if grown >= COOLING_GRAVE else 1
                new.append(Finding("cooling", None, level, now_ns, kind=Kind.FLOW))
                self.course.cooling[s] = True
        off, off_sd = float(f.z[s, at.inlet]), sqrt(float(f.P[s, at.inlet, at.inlet]))
        still = self.course.frozen[s] * f.dt >= FROZEN_S and not self.course.constant_inlet[s]
        if (
            "inlet" not in codes
            and still
            and not self.hot
            and abs(off - self.course.frozen_at[s]) > max(FROZEN_K, INLET_SURE * off_sd)
        ):
            new.append(Finding("inlet", None, 1, now_ns, kind=Kind.INLET, size=off))
        for g in new:
            self.findings.append(g)
            self._write(g, now_ns)
        return new

    def _grown(self) -> float:
        """Growth of R_u against what it has been."""
        return float(self.course.grown(self.of)[self.s])

    def _write(self, g: Finding, now_ns: int) -> None:
        s, f, at = self.s, self.of, self.of.at
        if g.kind is Kind.FLOW:
            g.size = self._grown()
        elif g.kind is Kind.INLET:
            g.size = float(f.z[s, at.inlet])
        elif g.kind is Kind.LOAD:
            g.size = min(g.size, max(0.0, float(f.made()[0][s])))
        elif g.kind is Kind.HEAT:
            h = at.heat.start + np.array(g.places)  # a sensor tells their sum better than where it sits
            g.heat, g.heat_sd = float(f.z[s, h].sum()), sqrt(max(0.0, float(f.P[s][np.ix_(h, h)].sum())))
        g.text = sentence(g, at.cells, now_ns)
