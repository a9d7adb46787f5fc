"""Mutants that no test can kill, by module: what is changed, and why nothing can be seen of it."""

NONE_FOR_NONE = "any negative number stands for none"
MORE_BINS = "one empty bin more than there are groups, never looked up"

EQUIVALENT: dict[str, dict[str, str]] = {
    "bms_gateway/bus/pace.py": {
        ": 10000000  ->  10000001": "a nanosecond of a bucket of ten milliseconds: no token more",
        "Pacer.offer: True  ->  False": "strict zip of three columns of one batch: they are of one length",
        "Pacer.head: now_ns > self._at_ns  ->  now_ns >= self._at_ns": "at one instant nothing is added either way",
        "Pacer.done: 0  ->  1": "a nanosecond, at bus time 0 alone: what is done was given by `head`",
    },
    "bms_gateway/frames/guard.py": {
        "Guard.__init__: 1  ->  2": NONE_FOR_NONE,
        "Guard.__init__: 1  ->  2  #2": "an array of two for one number: the second is never read",
        "Guard.__init__: 1  ->  2  #3": NONE_FOR_NONE,
        "Guard.__init__: 1  ->  2  #4": NONE_FOR_NONE,
        "Guard.__init__: 1  ->  2  #5": MORE_BINS,
        "Guard.update: 1  ->  2": MORE_BINS,
        "Guard._advance: 1  ->  2": MORE_BINS,
        "Guard._advance: 1  ->  2  #2": MORE_BINS,
        "Guard._judge: 0  ->  1": "a nanosecond of the rate of jumps: 2·10⁻¹⁰ K, below every signal's step",
        "Guard._judge: step < 1.01 * PROOF_K  ->  step <= 1.01 * PROOF_K": (
            "0.0505 K is 0.05 K with room for rounding; no signal steps by just that"
        ),
        "Guard._judge: usable & ~upset  ->  usable | ~upset": (
            "differs for samples that are usable and upset: there the cause remembered is the one of this sample"
        ),
        "Guard._follow_anchor: 1  ->  2  #4": "both sides of the comparisons of stays grow by one",
        "_rounds: np.arange(len(order)) - start.repeat(np.diff(np.append(start, len(order))))  ->  "
        "np.arange(len(order)) + start.repeat(np.diff(np.append(start, len(order))))": (
            "the samples of a channel still go into rounds in their order; rounds are more, some of them empty"
        ),
        "_rounds: 1  ->  2  #4": "one empty round more",
    },
}
