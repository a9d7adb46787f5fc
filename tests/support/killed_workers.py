"""A plugin of pytest by which workers end as killed ones do: without any clean-up."""

import os

import pytest


@pytest.hookimpl(tryfirst=True)
def pytest_unconfigure(config: pytest.Config) -> None:
    if hasattr(config, "workerinput"):
        os._exit(0)
