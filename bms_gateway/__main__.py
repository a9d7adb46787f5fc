"""Start of the program, as the command `bms-gateway` and as `python -m bms_gateway`."""

import sys


def start() -> int:
    """Load the program and run it; Ctrl-C while it is being loaded, or in its last moment, ends it as in between."""
    try:
        from bms_gateway.cli.main import main

        return main()
    except KeyboardInterrupt:
        sys.stderr.write("bms-gateway: stopped\n")
        return 130


if __name__ == "__main__":
    sys.exit(start())
