"""What the pages show is true: Python runs, commands run or parse, declarations load, nothing is left out silently.

A page is a session: its files, Python blocks and commands run in order, in one folder and one namespace. A comment in
front of a block says what else to do with it::

    <!-- file: my_robot/robot.yaml -->       it is a file of the session
    <!-- exit code: 3 -->                    its commands end so
    <!-- raises: SolverError -->             it ends with this error
    <!-- not run: takes minutes because -->  it is compiled or parsed, its imports are made, and that is all
"""

from __future__ import annotations

import ast
import importlib
import importlib.util
import re
import shlex
from pathlib import Path
from typing import Any

import click
import doc_blocks
import pytest
import yaml
from command_line import call
from doc_blocks import Block, blocks_of

import redundancy_pin as rp
from redundancy_pin.cli import main
from redundancy_pin.cli.problem import read_problem

ROOT = Path(__file__).resolve().parents[1]
MADE = ("docs/reference/api/names.md",)
"""Pages that others link to, and that are there once the site is built."""
GENERATED = ("docs/reference/api/modules", "docs/tutorials/notebooks")
PAGES = {
    path.relative_to(ROOT).as_posix(): path
    for path in sorted((ROOT / "docs").rglob("*.md"))
    if not path.relative_to(ROOT).as_posix().startswith(GENERATED)
}
OTHERS = {name: ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")}
"""Their Python is not run here: the README's Python runs in ``test_readme.py``."""

PYTHON, SHELL, DATA = ("python",), ("sh", "console", ""), ("yaml", "xml")
DIRECTIVES = re.compile(r"\{(toctree|eval-rst|image|include|literalinclude|note)\}")
OUTSIDE = ("pip", "make")
"""Programs whose commands are compared with the Makefile and pyproject.toml."""


@pytest.mark.long_for(
    "docs/compiled.md",
    "docs/design.md",
    "docs/forces.md",
    "docs/gallery.md",  # each block by itself: test_gallery.py
    "docs/guide/exchange.md",
    "docs/guide/start.md",
    "docs/guide/viewing.md",
    "docs/online.md",
    "docs/planning.md",
    "docs/questions.md",
    "docs/simulation.md",
    "docs/validation.md",
)
@pytest.mark.parametrize("name", [name for name, path in PAGES.items() if "```" in path.read_text(encoding="utf-8")])
def test_page_runs_as_it_is_written(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    session: dict[str, Any] = {"__name__": "__page__"}
    for block in blocks_of(PAGES[name], name):
        if "file" in block.marks:
            write(block, tmp_path)
        elif block.language in PYTHON:
            run_python(block, session)
        elif block.language in SHELL:
            for command in block.commands:
                run_command(block, command)
        else:
            assert DIRECTIVES.match(block.language), f"{block.where}: what is to be done with {block.language!r}?"


def test_commands_of_all_pages_parse() -> None:
    """Those of pages that take long to run, too, whose Python is compiled."""
    for block in (block for name, path in (PAGES | OTHERS).items() for block in blocks_of(path, name)):
        if block.language in PYTHON and block.page not in OTHERS:
            compile(block.text, block.where, "exec")
        elif block.language in SHELL and "file" not in block.marks:
            for command in block.commands:
                require_known(block, command)


def test_reasons_for_not_running_are_given() -> None:
    blocks = [block for name, path in PAGES.items() for block in blocks_of(path, name)]
    assert sum(block.language in PYTHON for block in blocks) > 5
    for block in blocks:
        reason = block.marks.get("not run")
        assert reason is None or len(reason) >= doc_blocks.LEAST_REASON, block.where


def test_every_public_name_has_a_docstring_and_a_page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    modules = importlib.import_module("api_pages").public_modules()
    assert modules[0] == "redundancy_pin"
    assert {"redundancy_pin.trajectory", "redundancy_pin.visualisation.figures.plots", "redundancy_pin.errors"} <= set(
        modules
    )
    for module in map(importlib.import_module, modules):
        for public in getattr(module, "__all__", ()):
            value = getattr(module, public)
            if callable(value) and not hasattr(value, "__args__"):
                assert (value.__doc__ or "").strip(), f"{module.__name__}.{public}"


def test_links_between_pages_lead_somewhere() -> None:
    for name, path in (PAGES | OTHERS).items():
        for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", path.read_text(encoding="utf-8")):
            made = (path.parent / target).relative_to(ROOT).as_posix() in MADE
            if "://" not in target and not made:
                assert (path.parent / target).exists(), f"{name}: {target}"


def test_formulas_become_mathml_with_indices_beside_dotted_letters(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("sphinx", reason="needs the extra docs")
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    mathml = importlib.import_module("mathml").mathml
    line = re.sub(r">\s+<", "><", mathml(r"\ddot\theta_i \leq \sum_j a", block=False))
    dotted = r"<msub><mover><mi>θ</mi><mo[^>]*>¨</mo></mover><mi>i</mi></msub>"
    assert re.search(dotted + r"<mo>≤</mo><munder|" + dotted + r"<mo>≤</mo><msub><mo[^>]*>∑", line), line
    assert 'display="block"' in mathml("a", block=True)


def test_the_table_of_extras_has_them_all() -> None:
    section = (ROOT / "pyproject.toml").read_text(encoding="utf-8").split("[project.optional-dependencies]")[1]
    extras = re.findall(r"^([a-z]+) = \[", section.split("\n[")[0], flags=re.M)
    rows = re.findall(r"^\| (`[a-z`, ]+`) \|", PAGES["docs/guide/start.md"].read_text(encoding="utf-8"), flags=re.M)
    assert sorted(re.findall(r"[a-z]+", " ".join(rows))) == sorted(extras)


def test_names_of_the_symbol_table_exist() -> None:
    text = (ROOT / "docs" / "reference" / "symbols.md").read_text(encoding="utf-8")
    two, three = (rp.load_robot(name) for name in ("2rpr", "3rrr"))
    for attribute in re.findall(r"`robot\.(\w+)`", text):
        assert hasattr(two, attribute), attribute
    for heading, robot in (("## 2-RPR", two), ("## 3-RRR", three)):
        section = text.split(heading)[1].split("\n## ")[0]
        second_cells = re.findall(r"^\|[^|]+\|([^|]*)\|", section, flags=re.M)
        arguments = set(re.findall(r"`(\w+)`", " ".join(second_cells))) - {"x"}  # the one that is no argument
        assert arguments
        assert arguments <= set(robot.parameters)


def write(block: Block, folder: Path) -> None:
    """Write a file of a session; a declaration or a problem is read back as soon as it can be."""
    path = folder / block.marks["file"]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(block.text, encoding="utf-8")
    if path.name == "robot.yaml":
        assert rp.load_robot(path).name == yaml.safe_load(block.text)["name"]
    elif path.suffix == ".yaml":
        read_problem(str(path))
    else:
        assert path.suffix in (".urdf", ".xacro", ".csv", ".xml", ".sdf"), f"{block.where}: nothing reads {path.name}"


def run_python(block: Block, session: dict[str, Any]) -> None:
    """Run a block, or only its imports; errors name the line of the page."""
    tree = ast.parse("\n" * (block.line - 1) + block.text, filename=block.page)
    if not block.runs:
        tree.body = [part for part in tree.body if isinstance(part, (ast.Import, ast.ImportFrom)) and _is_here(part)]
    code = compile(tree, block.page, "exec")
    try:
        exec(code, session)
    except Exception as error:
        if type(error).__name__ != block.marks.get("raises"):
            raise
    else:
        assert "raises" not in block.marks or not block.runs, f"{block.where}: no {block.marks['raises']}"


def _is_here(part: ast.Import | ast.ImportFrom) -> bool:
    """Return whether an import can be made; that of MuJoCo only where it is installed, since ``dev`` has it not."""
    return "mujoco" not in ast.unparse(part) or importlib.util.find_spec("mujoco") is not None


def run_command(block: Block, command: str) -> None:
    """Run a command of the package in the session's folder, or check that it could be run."""
    require_known(block, command)
    words = shlex.split(command, comments=True)
    if words[0] == "redundancy-pin" and block.runs:
        result = call(*words[1:])
        expected = int(block.marks.get("exit code", "0"))
        assert result.exit_code == expected, f"{block.where}: {command}: {result.exit_code}, {result.output}"


def require_known(block: Block, command: str) -> None:
    """Check that a command exists, with these options; other programs have to be known here."""
    words = shlex.split(command, comments=True)
    if not words:
        return
    if words[0] == "redundancy-pin":
        parse(words[1:], f"{block.where}: {command}")
    elif words[0] == "make":
        targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.M))
        assert {word for word in words[1:] if "=" not in word} <= targets, f"{block.where}: {command}"
    else:
        assert words[0] in OUTSIDE, f"{block.where}: {command}: is it a command, or does the block lack its language?"
        extras = re.findall(r"\[([a-z,]+)\]", command)
        text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
        for extra in ",".join(extras).split(",") if extras else ():
            assert re.search(rf"^{extra} = \[", text, flags=re.M), f"{block.where}: no extra {extra}"


def parse(words: list[str], where: str) -> None:
    """Let click read the arguments of a command without running it."""
    command: click.Command = main
    arguments = list(words)
    while isinstance(command, click.Group) and arguments and not arguments[0].startswith("-"):
        subcommand = command.get_command(click.Context(command), arguments.pop(0))
        assert subcommand is not None, f"{where}: no such command"
        command = subcommand
    try:
        command.make_context(words[0], arguments)
    except click.exceptions.Exit:
        pass  # --help
    except click.ClickException as error:
        pytest.fail(f"{where}: {error.format_message()}")
