"""Commands as a person calls them."""

import contextlib
import io
import json

from bms_gateway.cli.main import main


def call(*words) -> tuple[int, str, str]:
    """Exit status, standard output, standard error."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main([str(w) for w in words])
    return status, out.getvalue(), err.getvalue()


def told(*words) -> dict:
    """Document that a command writes to standard output."""
    status, out, err = call(*words, "--json", "-")
    assert status == 0, err
    return json.loads(out)
