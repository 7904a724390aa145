"""What is imported when: no command and no name of the package pays for libraries that it does not use."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path

import click
import pytest

import redundancy_pin as rp
from redundancy_pin.cli import COMMANDS, file_of, main

HEAVY = (
    *("numpy", "pinocchio", "scipy", "pydantic", "joblib", "xacro", "casadi", "matplotlib", "meshcat", "rich"),
    *("yaml", "click", "jinja2", "markdown_it", "daqp", "toppra", "contourpy", "sqlite3", "http.server", "numpy.ma"),
)
"""Libraries that take long to import, or that few need."""

KINEMATICS = {"numpy", "pinocchio", "pydantic", "xacro", "yaml"}
"""What it takes to read a robot and close its loops."""

PACKAGE = {
    "import redundancy_pin": set(),
    "import redundancy_pin as rp; dir(rp), rp.__all__, rp.__version__": set(),
    "import redundancy_pin as rp; rp.errors.InputError": set(),
    "import redundancy_pin as rp; rp.PlatformMotion, rp.CarrierMotion": {"numpy"},
    "import redundancy_pin as rp; rp.load_robot('3rrr')": KINEMATICS,
    "import redundancy_pin as rp; rp.RneaDynamics(rp.load_robot('2rpr')); rp.distribute": KINEMATICS,
}
COMMAND = "from redundancy_pin.cli import main\nmain({}, standalone_mode=False)"
COMMANDS_RUN = {
    COMMAND.format(["--version"]): {"click"},
    COMMAND.format(["--help"]): {"click"},
    COMMAND.format(["info", "--help"]): {"click", "numpy", "pinocchio", "yaml"},
    COMMAND.format(["info", "--json"]): {"click", "numpy", "pinocchio", "yaml"},
    COMMAND.format(["info"]): {"click", "numpy", "pinocchio", "yaml", "rich"},
    # efforts that hold the reference: one sample of inverse kinematics, whose equations LAPACK solves
    COMMAND.format(["info", "--robot", "3rrr"]): {*KINEMATICS, "click", "rich", "scipy", "numpy.ma"},
}
"""Of those, the ones that programs may load, one after another in the same process."""


@pytest.mark.parametrize("loaded", [PACKAGE, COMMANDS_RUN], ids=["package", "commands"])
def test_a_program_loads_what_it_uses(loaded: dict[str, set[str]]) -> None:
    report = f"import json, sys; print(json.dumps([name for name in {HEAVY} if name in sys.modules]), file=sys.stderr)"
    program = "".join(f"{each}\n{report}\n" for each in loaded)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    seen = [set(json.loads(line)) for line in done.stderr.splitlines()]
    for (each, allowed), there, before in zip(loaded.items(), seen, [set(), *seen], strict=False):
        assert before <= allowed, f"what was there before hides what is loaded by {each}"
        assert there <= allowed, each
    assert len(seen) == len(loaded)


def test_names_are_where_type_checkers_are_told_and_in_all() -> None:
    tree = ast.parse(Path(rp.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    told = {
        alias.asname: (node.module, alias.name)
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and node.module != "typing"
        for alias in node.names
    }
    assert len(told) > 50
    assert sorted(told) == sorted(rp.__all__)
    assert set(rp.__all__) <= set(dir(rp))
    for name, (module, original) in told.items():
        __import__(f"{module}.{original}" if name in ("simulation", "trajectory", "plot") else module)
        assert getattr(rp, name) is getattr(sys.modules[module], original), name


def test_names_that_are_not_there() -> None:
    assert not hasattr(rp, "no_such_name")
    with pytest.raises(AttributeError, match="'redundancy_pin' has no attribute 'no_such_name'"):
        _ = rp.no_such_name
    with pytest.raises(ImportError):
        exec("from redundancy_pin import no_such_name")


def test_the_list_of_commands_says_what_they_say_of_themselves() -> None:
    context = click.Context(main)
    assert main.list_commands(context) == sorted(COMMANDS)  # type: ignore[attr-defined]
    for name, text in COMMANDS.items():
        command = main.get_command(context, name)  # type: ignore[attr-defined]
        assert command is not None
        assert command.name == name
        assert command.get_short_help_str(100) == text
    assert main.get_command(context, "no-such-command") is None  # type: ignore[attr-defined]
    here = Path(sys.modules["redundancy_pin.cli"].__file__ or "").parent
    helpers = {"__init__", "errors", "options", "output", "problem"}
    assert {path.stem for path in here.glob("*.py") if path.stem not in helpers} == set(map(file_of, COMMANDS))
