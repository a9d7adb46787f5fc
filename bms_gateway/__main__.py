"""Start of the program, as the command `bms-gateway` and as `python -m bms_gateway`."""

import sys

STOPPED = 130


def start() -> int:
    """Load the program and run it; Ctrl-C while it is being loaded, or in its last moment, ends it as in between."""
    try:
        from bms_gateway.cli.main import main

        status = main()
    except KeyboardInterrupt:
        sys.stderr.write("bms-gateway: stopped\n")
        status = STOPPED
    if status == STOPPED:
        # An interrupt in code that `exec` runs from text, as for dataclasses, makes Python end itself by the signal,
        # caught or not, unless another text runs to its end
        exec("")  # noqa: S102
    return status


if __name__ == "__main__":
    sys.exit(start())
