"""Messages of the library speak Python; the command line, the pages and the browser say the same with options."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from magyc_gtsam.option_names import as_options

SOURCE = Path(__file__).parents[1]
# What only the command line and its pages say.
SPEAK_OPTIONS = ("magyc_gtsam/cli/", "magyc_gtsam/serve/", "magyc_gtsam/live/", "magyc_gtsam/study/")
SPEAK_OPTIONS += ("magyc_gtsam/report/gap_page.py", "magyc_gtsam/option_names.py", "magyc_gtsam/factors/")


def texts(source: str) -> list[str]:
    """Return the string constants of a module without its docstrings."""
    tree = ast.parse(source)
    described = [n for n in ast.walk(tree) if isinstance(n, ast.Module | ast.ClassDef | ast.FunctionDef)]
    docstrings = {id(n.body[0].value) for n in described if n.body and isinstance(n.body[0], ast.Expr)}
    found = (n for n in ast.walk(tree) if isinstance(n, ast.Constant) and id(n) not in docstrings)
    return [n.value for n in found if isinstance(n.value, str)]


def test_no_message_of_the_library_names_an_option() -> None:
    found = []
    for folder in ("magyc_gtsam", "factors"):
        for file in (SOURCE / folder).rglob("*.py"):
            name = file.relative_to(SOURCE).as_posix()
            if not name.startswith(SPEAK_OPTIONS):
                named = [text for text in texts(file.read_text()) if re.search(r"(^|[\s('\"`])--[a-z]", text)]
                found += [f"{name}: {text}" for text in named]
    assert not found


@pytest.mark.parametrize(
    ("message", "shown"),
    [
        ("choose an interval (start=, end=)", "choose an interval (--start, --end)"),
        ("read one side of it (end=3.5 or start=3.5)", "read one side of it (--end 3.5 or --start 3.5)"),
        ("use (stamps='log'), or (rate=)", "use (--stamps 'log'), or (--read rate=)"),
        (
            "bring both to one frame (gyroscope_axes='-y,x,z')",
            "bring both to one frame (--gyroscope-axes='-y,x,z')",
        ),
        ("have them corrected (clock_drift=7.9e-06)", "have them corrected (--option clock_drift=7.9e-06)"),
        ("say that they are (misalignment=np.radians(3))", "say that they are (--misalignment 3)"),
        ("or with (prior=, field=: hard iron)", "or with (--prior, --location, --date: hard iron)"),
        (
            "allow for a change (hard_iron_walk= and soft_iron_walk=)",
            "allow for a change (--hard-iron-walk and --soft-iron-walk)",
        ),
        ("has no option 'foo'; it has hard_iron_walk, window",) * 2,
        ("window must be above 0", "--window must be above 0"),
        ("method: 'smother' is not one of", "--method: 'smother' is not one of"),
        ('{"hard_iron_walk": 1e-6}', '{"hard_iron_walk": 1e-6}'),
        (
            "calibrate the magnetometer alone (`mg.calibrate` with method='autocal')",
            "calibrate the magnetometer alone (`magyc-gtsam calibrate` with --method 'autocal')",
        ),
        ("run `mg.find_gap`", "run `magyc-gtsam gap`"),
        ("see the values (force=True)", "see the values (--force)"),
        ("/logs/rate=5.csv: --start=3 --read rate=5", "/logs/rate=5.csv: --start=3 --read rate=5"),
    ],
)
def test_arguments_become_options(message: str, shown: str) -> None:
    assert as_options(message) == shown
    assert as_options(shown) == shown
