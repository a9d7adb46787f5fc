"""145 things that people hand to the program by mistake, written down before they were tried.

Each is one line on standard error, exit status 2, and a word that blames the right file, line or key.
"""

from tests.cli.bad_inputs.case import Case
from tests.cli.bad_inputs.configs import CONFIGS
from tests.cli.bad_inputs.dbcs import DBCS
from tests.cli.bad_inputs.logs import LOGS
from tests.cli.bad_inputs.models import MODELS
from tests.cli.bad_inputs.newcomers import NEWCOMERS
from tests.cli.bad_inputs.strangers import STRANGERS
from tests.cli.bad_inputs.tables import TABLES

__all__ = ["ALL", "Case"]

ALL: tuple[Case, ...] = (*TABLES, *LOGS, *DBCS, *CONFIGS, *MODELS, *STRANGERS, *NEWCOMERS)
