"""The adaptive observer: stacked Kalman filters that use identified parameters and state the uncertainty of the result.

The stated variance is P + J Σ Jᵀ. P is the variance of the filter if its parameters were exact. J Σ Jᵀ is what the
covariance Σ of the logarithms of the parameters adds, through the sensitivities J, which are stepped with the filter
(`sensitivity`). With wide priors, a small surface residual therefore does not make a narrow band around an unsensed
core. The scatter of the cells (the model's tolerances) is added cell by cell in steady-state proportions: a resistance
that is 3 % off shifts the temperature difference across it by 3 %.

New parameters rebuild the matrices. The estimate moves by J Δ ln θ, and each cell also by its own part of the change.
To first order, the estimate is then where it would be if the filter had always run with these parameters. So P + J Σ Jᵀ
holds from the first step on.
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from bms_gateway.errors import OtherStatesError, StateError
from bms_gateway.observe.bands import Bands, Deviations, Levers
from bms_gateway.observe.blocks import BLOCK, Blocks, Heat, chosen
from bms_gateway.observe.cell_scatter import apart_by, own_rise, root
from bms_gateway.observe.consider import Belief
from bms_gateway.observe.covariance_steps import EVERY
from bms_gateway.observe.estimate import Errors, Estimate
from bms_gateway.observe.forecast_start import Standing
from bms_gateway.observe.gap import resumed, unknown_heat, unseen_phases
from bms_gateway.observe.in_force import Heard, InForce
from bms_gateway.observe.kalman import Innovation, Kalman, KalmanState, Predicted
from bms_gateway.observe.model import OFFSETS, Bools, Ints, StackedModel, augmented, sensed, stack, start_covariance
from bms_gateway.observe.reversible import Reversible, completed
from bms_gateway.observe.sensitivity import (
    ENTROPIC_AT,
    PARAMETERS,
    R_E_AT,
    SYMBOLS,
    WARMTH_AT,
    Flows,
    bridged,
    carried,
    corrected,
    displaced,
)
from bms_gateway.observe.statistic_check import surprise_of
from bms_gateway.observe.stored import like, plain
from bms_gateway.observe.unseen import JUST_LEFT_S, RESTED_S, Usual, either, faded, opened
from bms_gateway.thermal import HEAT_GAIN_SD, Disturbance, Floats, Start, StringModel, StringParameters


class AdaptiveObserver:
    """Observer of S strings with n cells each.

    Parameters
    ----------
    models : sequence of StringModel
        Equal numbers of cells. Priors give the first parameters and their covariance.
    dt : float, s
        Step.
    disturbance : Disturbance, optional
    start : Start, optional
    several : bool
        Whether a reading may belong to one of several cells; `surprise.assign` then says to which.
    heat_rel_sd : float
        Relative error of heat that is measured instead of computed as I²R_e.

    Attributes
    ----------
    reversible : Reversible
        `reversible.flow` tells the current of the coming step; without it, the step has no reversible heat.

    References
    ----------
    Lin et al., Fig 5 (adaptive observer) and Fig 9–11 (strings); gain and band are not in the paper.

    Examples
    --------
    >>> from bms_gateway.thermal import Prior
    >>> table_1 = {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79}
    >>> priors = {symbol: Prior(value) for symbol, value in table_1.items()}
    >>> observer = AdaptiveObserver([StringModel(1, (1,), "single", priors)], 1.0)
    >>> nothing = np.array([[np.nan]])
    >>> e = observer.step(np.array([3600.0]), nothing, np.array([25.0]), np.array([[30.0]]), np.zeros((1, 1)))
    >>> bool(e.available[0]), round(float(e.surface[0, 0]), 1)
    (True, 30.0)
    """

    def __init__(
        self,
        models: Sequence[StringModel],
        dt: float,
        disturbance: Disturbance | None = None,
        start: Start | None = None,
        *,
        several: bool = False,
        heat_rel_sd: float = HEAT_GAIN_SD,
    ) -> None:
        if len({m.cells for m in models}) != 1:
            raise ValueError("an observer stacks strings with equal numbers of cells")
        disturbance, start = disturbance or Disturbance(), start or Start()
        self._dt, self._of, S, n = float(dt), InForce.of(models, heat_rel_sd), len(models), models[0].cells
        sensors, fitted = sensed(models)
        in_force = self._of.strings()
        self._kalman = Kalman(stack(in_force, dt, disturbance), sensors, fitted)
        self._flows, self.reversible = Flows.of(in_force), Reversible(models, dt)
        self._bands = Bands(models, sensors, fitted)
        self.surprise = surprise_of(in_force, sensors, dt, disturbance.sensor, several)
        self._bands.pace(self._of.parameters, self._dt)
        self.surprise.set_parameters(self._of.parameters)
        self._everywhere = np.arange(S)
        self._all_known = np.ones((S, OFFSETS), np.bool_)
        self._starts = np.stack([start_covariance(n, start, disturbance, inlet_known=known) for known in (False, True)])
        self._state = self._kalman.init(np.zeros((S, self._kalman.model.states)), np.repeat(self._starts[:1], S, 0))
        self._blocks = Blocks(S, self._kalman.model.states, n, sensors.shape[1])
        self._left = 0  # steps until the next block is full
        self._share_of_usual = faded(self._dt, disturbance.correlation)
        self._inlet, self._heard = np.zeros(S), Heard.nothing(sensors.shape)
        self._usual, self._available = Usual.nothing(S, n), np.zeros(S, np.bool_)
        self._everyone = False  # whether every string is available

    @property
    def parameters(self) -> tuple[StringParameters, ...]:
        """Numbers of the strings at nominal flow."""
        return tuple(self._of.parameters)

    def consider_warmth(self, sd: float) -> None:
        """Count, before the first step, B of R_e (`thermal.warmth`) as unknown by `sd`, 1000 K."""
        self._of.consider(WARMTH_AT, sd)

    def by_warmth(self) -> Floats:
        """R_e of the mean core of each string (S,) over R_e where it is known."""
        return np.asarray(self._of.by_warmth(self._state.x).mean(axis=1), dtype=np.float64)

    @property
    def covariances(self) -> Floats:
        """Covariance (S, M, M) of temperatures and offsets of each string if its parameters were exact."""
        return self._state.P

    @property
    def share(self) -> Floats:
        """Heat of each cell (S, n) over the mean of its string, as their R_e."""
        return self._of.share

    def step(
        self, I2: Floats, heat: Floats | None, inlet: Floats, y: Floats, age: Floats, flow_ratio: Floats | None = None
    ) -> Estimate:
        """Advance one step and use the readings.

        Parameters
        ----------
        I2 : ndarray (S,), A²
            Mean square of the current over the step; NaN where it is not known.
        heat : ndarray (S, n), W
            Mean heat where it is measured otherwise, as from the voltage; NaN (or None for all) means I²R_e.
        inlet : ndarray (S,), °C
            Coolant inlet now; NaN where missing: the last value is kept.
        y, age : ndarray (S, n), °C, s
            New surface readings (NaN: none) and how long before now they were taken.
        flow_ratio : ndarray (S,), optional
            Coolant flow over nominal flow; NaN or None keeps the last.

        Returns
        -------
        Estimate
        """
        if flow_ratio is not None:
            moved = self._of.follow_flow(flow_ratio)
            if len(moved):
                self._exchange(moved)
        self._begin(inlet, y)
        made, known_heat = self._heat(I2, heat)
        known = self._all_known
        if not (known_heat.all() and np.isfinite(inlet).all()):
            known = np.column_stack((np.isfinite(inlet), known_heat))
        inlet1 = inlet.copy() if known is self._all_known else np.where(known[:, 0], inlet, self._inlet)
        news = self._kalman.turned(self._state, known)
        if news is not None:
            self._turn(news, known, inlet1)
        was_known = self._state.pattern[:, -OFFSETS] >= 0
        inlet0 = np.where(was_known, self._inlet, inlet1)  # no ramp that starts from a held value
        whole = self.reversible.added_to(made.whole, made.amps, self._of.cores(self._state.x))
        predicted = self._kalman.predict(self._state, whole, inlet0, inlet1, known)
        state, innovation = self._kalman.update(predicted, y, age)
        self._state, self._inlet = state, inlet1
        surface = y.take(self._kalman.cell)
        grown = self.surprise.step(surface, innovation.value, innovation.sd, self._heard.firm, known, inlet1)
        if grown is not None:
            self._state, self._left = self._kalman.loosened(self._state, grown), 0
        if self._left > 0 and state.K is predicted.before.K:
            self._left -= 1
            self._blocks.wait(predicted, made)
            if not self._heard.fresh:
                self._heard.take(np.isfinite(innovation.value), self._dt)
        else:
            self._feel(predicted, innovation, made, (inlet0 + inlet1) / 2.0)
        levers = self._levers()
        self._bands.follow(levers)
        sd = self._bands.told(levers, None if self._everyone else self._available)
        return self._estimate(levers, sd, innovation.value, self.surprise.rounded(self._heard.sd))

    def _turn(self, news: Bools, known: Bools, inlet: Floats) -> None:
        """Use the news of inputs (S, 2) that are measured again or no longer, before the step in which this happens."""
        at, usual = np.flatnonzero(news.any(axis=1)), self._usual.mean.mean(axis=1)
        self._catch_up(at)
        state, disturbance = self._kalman.caught_up(self._state, at), self._kalman.model.disturbance
        x, P, J = state.x.copy(), state.P.copy(), self._blocks.J
        for s in at:
            moved = float(inlet[s] - self._inlet[s])
            b = resumed(Belief(x[s], P[s], J[s]), news[s] & known[s], moved, self._of.cov[s], disturbance)
            if news[s, 1] and not known[s, 1]:
                b = unknown_heat(b, float(usual[s]), disturbance)
            x[s], P[s], J[s] = b.z, b.P, b.J
        self._state = replace(state, x=x, P=P)

    def _feel(self, step: Predicted, innovation: Innovation, made: Heat, inlet: Floats) -> None:
        """Add a step to the sensitivities, make the steps that need not wait, and update the bands of their strings."""
        self._heard.take(np.isfinite(innovation.value), self._dt)
        self._heard.fresh = bool((self._heard.unread == 0.0).all())
        blocks, state, kalman = self._blocks, self._state, self._kalman
        moved = state.since == 0
        at = np.flatnonzero(moved | (blocks.waiting >= BLOCK))
        J = blocks.J[:0]
        if len(at):
            J0 = blocks.caught_up(at, self._flows, kalman, step.before)
            middle = (chosen(step.before.x, at) + chosen(step.x, at)) / 2.0
            given = np.zeros((len(at), self._of.cells)) if made.given is None else chosen(made.given, at)
            heats = chosen(made.electric, at), given, chosen(inlet, at)
            amps = None if made.amps is None else chosen(made.amps, at)
            forcing = self._flows.of_strings(at).forcing(middle, *heats, amps)
            J = carried(J0, chosen(kalman.model.A, at), forcing, self._dt)
            J, seen = corrected(J, J0, chosen(state.K, at), chosen(kalman.sensors, at), chosen(innovation.lag, at))
            self._bands.know(at, state.P, J, self._of.root, seen)
        blocks.wait(step, made)
        blocks.put(at, J)
        blocks.forget(np.flatnonzero(moved), state)
        self._left = BLOCK - int(blocks.waiting.max())
        self._heard.sd, self._heard.firm = self._bands.of_readings(innovation.sd)

    def estimate(self) -> Estimate:
        """Return the present state of the strings, with no innovation; nothing changes."""
        J = self._blocks.caught_up(self._everywhere, self._flows, self._kalman, self._state)
        levers, nothing = self._levers(), np.full(self._heard.unread.shape, np.nan)
        sd = self._bands.now(self._state.P, J, self._of.root, levers, self._available)
        return self._estimate(levers, sd, nothing, nothing)

    def standing(self) -> Standing:
        """Return all that a forecast starts from; the bands do not yet contain the steps that wait (`blocks`)."""
        now = self._state.x, self._state.P, self._blocks.J.copy(), self._of.root, self.parameters, self._of.level
        own = self._of.gain, self._inlet, self._bands.lag.copy(), self._bands.unlike(self._levers())
        warmth = self.reversible.value, self.reversible.charge, self._of.B, self._of.u_0
        return Standing(*now, *own, self._available, self._kalman.model.disturbance, *warmth)

    def set_parameters(
        self,
        s: int,
        values: Mapping[str, float | Floats],
        names: Sequence[str],
        covariance: Floats,
        own: Floats | None = None,
    ) -> None:
        """Take identified parameters of string `s` into use.

        Parameters
        ----------
        s : int
        values : mapping of symbol to value
            SI, at nominal flow, one for all cells or one per cell; a symbol that is not named keeps its value. `heat`
            is the factor on measured heat; see also `Reversible.exchange` and `InForce.state_resistance`.
        names : sequence of str
            Symbols of `PARAMETERS` to which the covariance belongs.
        covariance : ndarray (p, p)
            Of the logarithms, mV/K for reversible heat, 1000 K for B. The variance of others stays, uncorrelated.
        own : ndarray (n, 3, 3), optional
            Covariance of each cell's ln R_e, ln R_u, ln R_c about what is common to the cells; None for the model's
            tolerances.

        Raises
        ------
        ConfigError
            Bulk coolant node with R_u C_f ≤ 1 at nominal flow.
        """
        old, new = self._of.parameters[s], self._of.moved(s, values)
        gain = float(values.get("heat", self._of.gain[s]))
        moved, apart = apart_by(old, new, gain / self._of.gain[s])
        rise, over, gap = self._levers()[:3, s]
        self._catch_up(np.array([s]))
        moved[ENTROPIC_AT] = self.reversible.exchange(s, values, self._blocks.J[s, :, ENTROPIC_AT])
        self._of.exchange(s, new, gain, names, covariance)
        if "R_e" in names:
            grown, moved[WARMTH_AT] = self._of.state_resistance(s, values, self._blocks.J[s])
            moved[R_E_AT] -= grown
        self._exchange(np.array([s]))
        self.surprise.settle(s)
        x = self._state.x.copy()
        x[s] += displaced(self._blocks.J[s], moved)
        if self._available[s]:
            x[s, : 2 * self._of.cells] += own_rise(apart, rise, over, gap)
        self._bands.move(s, x[s] - self._state.x[s])
        self._state = replace(self._state, x=x)
        self._bands.differ(s, own)

    def propagate(self, gap_s: float, inlet: Floats | None = None, *, unseen: bool = False) -> Estimate:
        """Carry all strings over a time without frames: the bus was silent, or the gateway was off.

        Parameters
        ----------
        gap_s : float, s
            > 0.
        inlet : ndarray (S,), optional
            Coolant inlet after the gap, °C; NaN or None: the last value.
        unseen : bool
            Whether current may have flowed, because the gateway was off and not the bus (see `unseen`).

        Returns
        -------
        Estimate
            No heat during the gap; bands grow towards those of a rested string with an unknown inlet.
        """
        self._catch_up(self._everywhere)
        disturbance, usual, J = self._kalman.model.disturbance, self._usual.mean.mean(axis=1), self._blocks.J.copy()
        if unseen:
            state = self._kalman.caught_up(self._state, self._everywhere)
            x, P, J = opened(state.x, state.P, J, gap_s, usual, disturbance)
            self._state = replace(state, x=x, P=P)
        in_force = self._of.strings()
        inlet1 = self._inlet if inlet is None else np.where(np.isfinite(inlet), inlet, self._inlet)

        def over(parameters: Sequence[StringParameters]) -> StackedModel:
            return stack(parameters, gap_s, disturbance, by_resistance=unseen)

        gap = over(in_force)
        self._blocks.put(self._everywhere, bridged(J, self._state.x, in_force, over, self._inlet, inlet1))
        self._state = self._kalman.propagate(self._state, gap, self._inlet, inlet1, unseen=unseen)
        if unseen:
            A = [augmented(p, disturbance, by_resistance=True).A for p in in_force]
            more = [unseen_phases(a, gap_s, float(q), disturbance) for a, q in zip(A, usual, strict=True)]
            self._state = replace(self._state, P=self._state.P + np.stack(more))
        self._bands.rest(self._state.x, gap_s)
        self._inlet = inlet1.copy()
        self._heard.pass_time(gap_s)
        self._usual = self._usual.aged(faded(gap_s, disturbance.correlation))
        return self.estimate()

    def propagate_unknown(self) -> None:
        """Carry all strings over a time of unknown length: the clock cannot be trusted."""
        self._catch_up(self._everywhere)
        state, inlet, usual, unread = self._state, self._inlet, self._usual, self._heard.unread
        J = self._blocks.J.copy()
        self.propagate(RESTED_S)
        rested, J_rested = self._state, self._blocks.J.copy()
        self._state, self._inlet, self._usual, self._heard.unread = state, inlet, usual, unread
        self._blocks.put(self._everywhere, J)
        self.propagate(JUST_LEFT_S, unseen=True)
        x, P = either(self._state.x, self._state.P, rested.x, rested.P)
        self._state = replace(self._state, x=x, P=P)
        self._bands.rest(x, RESTED_S)
        self._blocks.put(self._everywhere, (self._blocks.J + J_rested) / 2.0)

    def snapshot(self) -> dict[str, Any]:
        """Return all that a restart needs, as numbers, lists and None for NaN."""
        own = {name: plain(value) for name, value in self._kept().items()} | self._usual.snapshot()
        own |= self.reversible.snapshot()
        own["J"] = plain(self._blocks.caught_up(self._everywhere, self._flows, self._kalman, self._state))
        block = self._blocks.snapshot() | self._bands.snapshot()
        state = {f.name: plain(getattr(self._state, f.name)) for f in fields(KalmanState)}
        values = [{k: plain(np.asarray(getattr(p, k))) for k in SYMBOLS} for p in self._of.parameters]
        cells = plain(self._bands.own) if self._bands.owned else None
        found = {"own": own, "state": state, "parameters": values, "cells": cells, "block": block}
        return found | {"surprise": self.surprise.snapshot()}

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        """Continue from `snapshot`, bit for bit as if the observer had never stopped.

        Raises
        ------
        OtherStatesError
            The snapshot has another number of states.
        StateError
            It belongs to other strings, is incomplete, or holds values that are not numbers.
        """
        try:
            x, P = np.shape(snapshot["state"]["x"]), np.shape(snapshot["state"]["P"])
            states = self._state.x.shape[1]
            if (*x, x[-1]) == P and x[-1] != states:  # if x and P disagree, it is corrupt, not of another form
                raise OtherStatesError(f"observer state: a string has {x[-1]} states in it, and {states} here")
            snapshot = completed(snapshot, len(self._inlet), self._of.cov[0])
            reversible = Reversible(self._of.models, self._dt)
            reversible.restore(snapshot["own"])
            own = {k: like(snapshot["own"][k], value) for k, value in self._kept().items()}
            usual = self._usual.restored(snapshot["own"])
            names = [f.name for f in fields(KalmanState)]
            state = KalmanState(**{k: like(snapshot["state"][k], getattr(self._state, k)) for k in names})
            J = like(snapshot["own"]["J"], self._blocks.J)
            surprise = self.surprise.restored(snapshot.get("surprise"))
            blocks = Blocks(len(self._inlet), state.x.shape[1], self._of.cells, self._heard.unread.shape[1])
            block = snapshot.get("block")  # states of older versions have no waiting steps
            if block is None:
                blocks.put(self._everywhere, J)
            else:
                blocks.restore(block)
            cells = snapshot.get("cells")
            owned = self._bands.own if cells is None else like(cells, self._bands.own)
            bands = Bands(self._of.models, self._kalman.sensors, self._kalman.fitted)
            bands.rest(state.x, RESTED_S)
            if block is not None:
                bands.restore(block, state.P, blocks.J, np.stack([root(c) for c in own["cov"]]))
            values = zip(self._of.models, self._of.parameters, snapshot["parameters"], strict=True)
            parameters = [
                m.parameters({k: like(v[k], np.asarray(getattr(p, k))) for k in m.priors}) for m, p, v in values
            ]
        except (IndexError, KeyError, TypeError, ValueError) as e:
            raise StateError(f"observer state: not of these strings ({type(e).__name__}: {e})") from e
        if not all(
            np.isfinite(a).all()
            for a in (state.x, state.P, state.K, J, own["cov"], own["inlet"], own["B"], own["u_0"], owned, bands.lag)
        ):
            raise StateError("observer state: holds values that are not numbers")
        self._of.restore(parameters, own)
        self._inlet, self._available = own["inlet"], own["available"]
        self._heard.unread, self._heard.fresh, self.reversible = own["unread"], False, reversible
        self._state, self._usual, self.surprise = state, usual, surprise
        bands.own, bands.owned = owned, cells is not None
        self._blocks, self._bands = blocks, bands
        self._everyone = bool(self._available.all())
        self._exchange(self._everywhere, restored=True)
        if block is None:
            bands.know(self._everywhere, state.P, J, self._of.root, np.zeros((*own["unread"].shape, len(PARAMETERS))))

    def _kept(self) -> dict[str, Any]:
        """List what a snapshot holds besides the filter's state and the parameters."""
        of, heard = self._of, self._heard
        found = {"cov": of.cov, "gain": of.gain, "inlet": self._inlet, "unread": heard.unread, "level": of.level}
        return {**found, "B": of.B, "u_0": of.u_0, "available": self._available}

    def _begin(self, inlet: Floats, y: Floats) -> None:
        """Start the strings that have their first inlet or reading now."""
        if self._everyone:
            return
        heard: Bools = np.isfinite(y)
        new = np.flatnonzero(~self._available & (heard.any(axis=1) | np.isfinite(inlet)))
        if not len(new):
            return
        x, P, known = self._state.x.copy(), self._state.P.copy(), np.isfinite(inlet[new])
        level = np.array([float(np.mean(y[s][heard[s]])) if heard[s].any() else float(inlet[s]) for s in new])
        x[new, : 2 * self._of.cells] = level[:, None]
        x[new, 2 * self._of.cells :] = 0.0
        P[new] = self._starts[known.astype(np.int64)]
        self._state = self._state.begun(new, x, P)
        self._inlet, self._available = self._inlet.copy(), self._available.copy()
        self._blocks.put(new, np.zeros_like(self._blocks.J[new]))
        self._inlet[new] = np.where(known, inlet[new], level)
        self._available[new] = True
        self._everyone, self._left = bool(self._available.all()), 0

    def _heat(self, I2: Floats, heat: Floats | None) -> tuple[Heat, Bools]:
        """Return the heat, the usual one if it is unknown, and which strings' heat is known."""
        electric = I2[:, None] * self._of.R_e * self._of.by_warmth(self._state.x)
        given, known = None, np.asarray(np.isfinite(I2), dtype=np.bool_)
        if heat is not None and (measured := np.isfinite(heat)).any():
            electric = np.where(measured, 0.0, electric)
            given = np.where(measured, self._of.gain[:, None] * heat, 0.0)
            known = np.asarray(np.isfinite(electric).all(axis=1), dtype=np.bool_)
        every = bool(known.all())
        if not every:
            electric = np.where(np.isfinite(electric), electric, self._usual.mean)
        made = Heat(electric, given, self.reversible.pass_step())
        self._usual = self._usual.after(made.whole, self._share_of_usual, every or known[:, None])
        return made, known

    def _exchange(self, at: Ints, *, restored: bool = False) -> None:
        """Rebuild the matrices of the strings `at`, whose parameters or flow have changed."""
        self._left = 0
        self._heard.forget()
        if not restored:
            self._catch_up(at)
            state = self._kalman.caught_up(self._state, at)
            held = state.held.copy()
            held[at] = np.minimum(held[at], EVERY - 1)  # a small change: the next step is computed, strides start short
            self._state = replace(state, held=held)
        self._blocks.forget(at)
        in_force = [self._of.string(int(s)) for s in at]
        self._kalman = self._kalman.exchanged(at, stack(in_force, self._dt, self._kalman.model.disturbance))
        self._flows = self._flows.exchanged(at, Flows.of(in_force, self.reversible.value[at], self._of.u_0[at]))
        self._bands.pace(self._of.parameters, self._dt)
        self.surprise.set_parameters(self._of.parameters)

    def _catch_up(self, at: Ints) -> None:
        """Make the waiting steps of the sensitivities of the strings `at`."""
        self._left = 0
        self._blocks.put(at, self._blocks.caught_up(at, self._flows, self._kalman, self._state))

    def _estimate(self, levers: Levers, sd: Deviations, innovation: Floats, innovation_sd: Floats) -> Estimate:
        cells = self._bands.of_cells(levers, sd, None if self._everyone else self._available)
        return Estimate(*cells, Errors(innovation, innovation_sd, self._bands.on_cells), self._available)

    def _levers(self) -> Levers:
        """Return the levers of the cells (`bands`); renew their base if other surfaces are read than before."""
        if (read := self._heard.newly()) is not None:
            self._bands.rest_on(self._flows, self._kalman.sensors, read)
        return self._bands.levers(self._state.x, self._inlet)
