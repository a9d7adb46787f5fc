"""The process that computes for one tab: requests as lines of JSON on standard input, answers on standard output.

An answer is `{"share", "text"}` or, of an addition, `{"trial": {...}}` while it works, then `{"done": {...}}` or
`{"error": "one line"}`. It ends with its input, or when nobody reads what it says.
"""

import json
import os
import sys
from typing import Any, TextIO

NICE = 5
"""The page, which a person looks at, comes first."""


def main() -> None:
    """Answer until the input ends."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.nice(NICE)
    # what a library prints must not stand between the answers
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    from bms_gateway.errors import GatewayError
    from bms_gateway.report.words import labelled
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
                _say(answers, {"error": " ".join(str(e).split())})
            else:
                _say(answers, {"done": done})
    except BrokenPipeError:
        os._exit(0)  # the server has gone; nothing is left to be said, and nobody to say it to


def _say(answers: TextIO, document: dict[str, Any]) -> None:
    answers.write(json.dumps(document, ensure_ascii=False, separators=(",", ":"), allow_nan=False) + "\n")
    answers.flush()


if __name__ == "__main__":
    main()
