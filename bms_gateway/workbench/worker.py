"""The process that computes for one tab: requests as lines of JSON on standard input, answers on standard output.

An answer is `{"share", "text"}` or, for an addition, `{"trial": {...}}` during the work, then `{"done": {...}}` or
`{"error": "one line"}`. The process ends when its input ends, or when its output is no longer read.
"""

import json
import os
import signal
import sys
from typing import Any, TextIO

NICE = 5
"""Priority below that of the page, which a person looks at."""


def main() -> None:
    """Answer until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends it also during a fit, without a message
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.nice(NICE)
    # output of libraries must not mix with the answers
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    from bms_gateway.errors import GatewayError
    from bms_gateway.report.words import labelled, on_page
    from bms_gateway.workbench.bench import Bench

    bench = Bench()

    def tell(share: float, text: str) -> None:
        _say(answers, {"share": round(share, 4), "text": labelled(text)})

    def show(trial: dict[str, Any]) -> None:
        _say(answers, {"trial": trial})

    try:
        for line in sys.stdin:
            try:
                done = bench.answer(json.loads(line), tell, show)
            except GatewayError as e:
                _say(answers, {"error": on_page(" ".join(str(e).split()))})
            else:
                _say(answers, {"done": done})
    except BrokenPipeError:
        os._exit(0)  # the server has ended, so nothing can be reported


def _say(answers: TextIO, document: dict[str, Any]) -> None:
    answers.write(json.dumps(document, ensure_ascii=False, separators=(",", ":"), allow_nan=False) + "\n")
    answers.flush()


if __name__ == "__main__":
    main()
