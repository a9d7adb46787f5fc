"""Our DBC is parsed once for all tests of a run."""

from tests.config.conftest import _parsed_once  # noqa: F401
