"""`python -m bms_gateway`: the same as the command `bms-gateway`."""

import sys

from bms_gateway.cli.main import main

sys.exit(main())
