"""The public names: they stay, each is there, and none is loaded before it is asked for."""

import doctest
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import bms_gateway as bms

PACKAGE = Path(bms.__file__).parent
NAMES = {
    *("Added", "Columns", "Compared", "Cores", "Diagnosed", "Fit", "GatewayError", "Observer", "Placed", "Record"),
    *("Signal", "StringModel", "__version__"),
    *("add", "cell_model", "compare", "decode", "diagnose", "fit", "place", "read_model", "read_records"),
    "write_model",
}
"""What people have written into their notebooks."""
EXAMPLES = sorted(p for p in PACKAGE.rglob("*.py") if ">>> " in p.read_text(encoding="utf-8"))


def test_no_public_name_has_gone():
    assert set(bms.__all__) == NAMES
    assert set(dir(bms)) >= NAMES
    for name in NAMES:
        found = getattr(bms, name)
        assert found.__doc__, name


def test_a_name_that_is_none_is_told():
    with pytest.raises(AttributeError, match="has no attribute 'observer'"):
        _ = bms.observer


def test_a_function_stays_one_whichever_modules_are_loaded():
    code = (
        "import bms_gateway.diagnosis.compare as c, bms_gateway as b; print(callable(b.compare), callable(b.diagnose))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.split() == ["True", "True"]


def test_nothing_is_loaded_before_it_is_asked_for():
    code = "import sys; bare = set(sys.modules); import bms_gateway; print(*set(sys.modules) - bare)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(out.stdout.split()) - sys.stdlib_module_names == {"bms_gateway"}


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_every_example_of_a_docstring_is_true(file):
    parts = file.relative_to(PACKAGE.parent).with_suffix("").parts
    module = importlib.import_module(".".join(parts).removesuffix(".__init__"))
    told = doctest.testmod(module)
    assert told.failed == 0
    assert told.attempted > 0
