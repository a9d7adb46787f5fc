"""What the benchmark of honesty prints: a line per case and method, then what is to be reached over all of them."""

from collections.abc import Sequence

import numpy as np

from tests.benchmarks.honesty_case import HONEST, SPANS, WRONG, Outcome
from tests.benchmarks.honesty_scores import Score
from tests.benchmarks.honesty_simulated import CONTROLS, FLOW, KINDS

START = "{:46}{:>24}{:>16}"
NUMBERS = "  RMSE K   bias  inside  worst   sd K   CRPS  max/sd  told"
HEAD = START.format("case", "priors", "method") + NUMBERS


def case_lines(o: Outcome) -> list[str]:
    """One line per span; of measured cells the first span alone."""
    start = START.format(o.case, o.priors, o.method)
    if not o.scores:
        return [f"{start}  " + ("not added: the measurements speak against it" if o.refused else f"failed: {o.error}")]
    spans = ["settled"] if o.kind == "measured" else list(SPANS)
    texts = [_numbers(o.scores[span]) for span in spans if span in o.scores]
    mark = "  CONFIDENTLY WRONG" if any(o.confidently_wrong(span) for span in spans) else ""
    told = "".join(f"  {name} from {at:.0f} s" for name, at in sorted(o.told.items()))
    return [start + texts[0] + mark + told, *(f"{'':70}{'late':>16}" + text for text in texts[1:])]


def _numbers(s: Score) -> str:
    text = f"{s.rmse:8.2f}{s.bias:+7.2f}"
    if s.sd > 0:
        text += f"{100 * s.inside:6.0f} %{100 * s.inside_worst:5.0f} %{s.sd:7.2f}{s.crps:7.2f}{s.error_sd:8.1f}"
        text += f"{100 * s.told:4.0f} %"
    else:
        text += f"{'-':>8}{'-':>7}{'-':>7}{s.crps:7.2f}"
    return text + (f"  stated only {100 * s.known:.0f} %" if s.known < 0.99 else "")


def measured_summary(outcomes: Sequence[Outcome]) -> list[str]:
    """Lines by priors and method over measured cells: what is to be reached, and what the peers reach."""
    if not outcomes:
        return []
    lines = [START.format("measured cells", "priors", "method")]
    lines[0] += "    CRPS  honest  worse with voltage  wrong, not told  CPU s"
    for key in dict.fromkeys((o.priors, o.method) for o in outcomes):
        some = [o for o in outcomes if (o.priors, o.method) == key]
        known = {o.case: o.scores["settled"] for o in some if o.scores}
        pairs = [(x.crps, known[f"{c} + V"].crps) for c, x in known.items() if f"{c} + V" in known]
        worse = sum(v > without for without, v in pairs)
        row = START.format(f"{len(some)} cases", *key) + f"{_mean(x.crps for x in known.values()):8.3f}"
        if any(x.sd > 0 for x in known.values()):
            quiet = sum(x.inside < HONEST and x.told == 0 for x in known.values())
            row += f"{sum(o.honest() for o in some):6}/{len(some)}{worse:18}/{len(pairs)}{quiet:15}/{len(some)}"
            row += f"{sum(o.seconds for o in some):7.0f}"
        lines.append(row + _failed(some))
    return lines


def simulated_summary(outcomes: Sequence[Outcome]) -> list[str]:
    """Lines by priors, method, span and kind over simulated drives."""
    lines = []
    for key in dict.fromkeys((o.priors, o.method) for o in outcomes):
        mine = [o for o in outcomes if (o.priors, o.method) == key]
        for span, since in SPANS.items():
            lines += ["", f"{key[1]}, {key[0]} priors, from minute {since / 60:.0f} on"]
            head = f"{'':30}{'cases':>6}{'confidently wrong':>19}{'wrong':>7}{'told':>6}{'honest':>8}{'inside':>8}"
            lines.append(head + f"{'worst cell':>12}{'CRPS':>7}{'RMSE':>7}{'sd/rms':>8}{'(median)':>9}")
            for kind in (*KINDS, "all"):
                some = [o for o in mine if kind in (o.kind, "all")]
                if some:
                    lines.append(_kind_line(kind, some, span))
            lines += _conclusions(mine, span)
    return lines


def _kind_line(kind: str, some: list[Outcome], span: str) -> str:
    s = [o.scores[span] for o in some if o.scores]
    if not s:
        return f"{kind:30}{len(some):6}" + _failed(some)
    ratio = [x.sd_ratio for x in s]
    line = (
        f"{kind:30}{len(some):6}{sum(o.confidently_wrong(span) for o in some):19}{sum(x.inside < WRONG for x in s):7}"
    )
    line += (
        f"{sum(x.told > 0 for x in s):6}{sum(o.honest(span) for o in some):8}{100 * _mean(x.inside for x in s):6.1f} %"
    )
    line += f"{100 * _mean(x.inside_worst for x in s):10.1f} %"
    line += f"{_mean(x.crps for x in s):7.2f}{_mean(x.rmse for x in s):7.2f}"
    return line + f"{min(ratio):8.1f}-{max(ratio):.1f} ({np.median(ratio):.1f})" + _failed(some)


def _conclusions(mine: list[Outcome], span: str) -> list[str]:
    """The figures with a goal."""
    scored = [o for o in mine if o.scores]
    hidden = [o for o in scored if o.kind not in (*CONTROLS, FLOW)]
    wrong = [o for o in hidden if o.confidently_wrong(span)]
    honest = [o for o in scored if o.honest(span)]
    controls = [o.scores[span] for o in scored if o.kind in CONTROLS]
    lines = []
    if hidden:
        outside = _mean(o.scores[span].untold for o in hidden)
        lines.append(
            f"something hidden: confidently wrong (< {100 * WRONG:.0f} % inside, nothing told) {len(wrong)} of "
            f"{len(hidden)} ({100 * len(wrong) / len(hidden):.1f} %); outside 2 sd while nothing is told: "
            f"{100 * outside:.1f} % of the time"
        )
    if controls:
        ratio = [c.sd_ratio for c in controls]
        lines.append(
            f"nothing hidden: {100 * _mean(c.inside for c in controls):.1f} % inside, sd over rms error "
            f"{min(ratio):.1f} to {max(ratio):.1f} (median {np.median(ratio):.1f}), something told in "
            f"{sum(c.told > 0 for c in controls)} of {len(controls)}"
        )
    if honest:
        quiet = sum(o.scores[span].told == 0 for o in honest)
        lines.append(
            f"honest: {len(honest)} of {len(scored)}, mean CRPS {_mean(o.scores[span].crps for o in honest):.2f} K; "
            f"nothing told in {quiet} of them"
        )
    return lines


def compared(outcomes: Sequence[Outcome], ours: str, before: str, *, span: str = "settled") -> list[str]:
    """Lines: cases paired by the two methods, and every one whose CRPS moved by more than a twentieth."""
    pairs = {}
    for o in outcomes:
        if o.scores and o.method in (ours, before):
            pairs.setdefault((o.case, o.priors), {})[o.method] = o
    both = [p for p in pairs.values() if len(p) == 2]
    if not both:
        return []
    crps = np.array([[p[m].scores[span].crps for m in (ours, before)] for p in both])
    was_honest = np.array([p[before].honest(span) for p in both])
    worse, better = crps[:, 0] > 1.05 * crps[:, 1], crps[:, 0] < 0.95 * crps[:, 1]
    now, then = crps.mean(axis=0).tolist()
    lines = [
        f"{ours} against {before}, {len(both)} pairs: mean CRPS {now:.3f} against {then:.3f}; "
        f"better in {better.sum()}, worse in {worse.sum()}, of the {was_honest.sum()} honest before worse in "
        f"{(worse & was_honest).sum()}, no longer honest "
        f"{sum(not p[ours].honest(span) for p, was in zip(both, was_honest, strict=True) if was)}"
    ]
    for p, (now, then), moved in zip(both, crps.tolist(), worse, strict=True):
        if moved:
            a, b = p[ours].scores[span], p[before].scores[span]
            lines.append(
                f"  worse: {p[ours].case}: CRPS {then:.2f} -> {now:.2f}, RMSE {b.rmse:.2f} -> {a.rmse:.2f}, "
                f"sd {b.sd:.2f} -> {a.sd:.2f}, inside {100 * b.inside:.0f} -> {100 * a.inside:.0f} %"
            )
    return lines


def _failed(some: Sequence[Outcome]) -> str:
    failed, refused = sum(bool(o.error) for o in some), sum(o.refused for o in some)
    return (f"  {failed} FAILED" if failed else "") + (f"  {refused} not added" if refused else "")


def _mean(values) -> float:
    some = list(values)
    return float(np.mean(some)) if some else float("nan")
