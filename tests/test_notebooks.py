"""The notebooks run from top to bottom, end with asserted numbers, and store no output."""

from __future__ import annotations

import ast
import os
import re
import tempfile
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from traitlets.config import Config

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))

EACH_CELL = 120
"""s after which a cell counts as hanging; the slowest takes three on a quiet core."""

each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def _read(path: Path) -> Any:
    return nbformat.read(path, as_version=4)


def _run(notebook: Any, folder: Path) -> None:
    """Execute a notebook in an empty folder, apart from the settings of whoever runs the tests.

    The kernel is reached through sockets in the file system: ports of TCP are drawn before they are bound, and kernels
    started side by side can draw the same.
    """
    # not pytest's own folder: the path of a socket is limited to about a hundred characters
    with tempfile.TemporaryDirectory(prefix="nb") as private:
        connection = {"transport": "ipc", "connection_file": f"{private}/kernel.json"}
        client = NotebookClient(
            notebook,
            kernel_name="python3",
            timeout=EACH_CELL,
            resources={"metadata": {"path": str(folder)}},
            config=Config({"KernelManager": connection}),
        )
        client.execute(env={**os.environ, "IPYTHONDIR": f"{private}/ipython"})


def _code(notebook: Any) -> list[Any]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def test_they_are_numbered() -> None:
    """The site lists them all by itself (docs/conf.py); README names the first."""
    assert NOTEBOOKS
    assert [path.name[:3] for path in NOTEBOOKS] == [f"{i:02}_" for i in range(1, len(NOTEBOOKS) + 1)]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert re.findall(r"\(notebooks/([^)]*)\)", readme) == [NOTEBOOKS[0].name]


@each_notebook
def test_it_stores_no_output_and_nothing_of_the_machine(path: Path) -> None:
    notebook = _read(path)
    nbformat.validate(notebook)
    assert notebook.metadata.kernelspec.name == "python3"
    assert set(notebook.metadata) <= {"kernelspec", "language_info"}
    for cell in _code(notebook):
        assert cell.outputs == []
        assert cell.execution_count is None
    assert not any(cell.metadata or cell.get("attachments") for cell in notebook.cells)
    assert not re.search(r"(?<![\w.])/(home|root|tmp|usr|work|Users)\b", path.read_text(encoding="utf-8"))


@each_notebook
def test_its_links_lead_somewhere(path: Path) -> None:
    text = "\n".join(cell.source for cell in _read(path).cells if cell.cell_type == "markdown")
    for link in re.findall(r"\]\((?!https?:)([^)#]+)", text):
        assert (path.parent / link).is_file(), link


@each_notebook
def test_it_ends_with_asserted_numbers(path: Path) -> None:
    last = _read(path).cells[-1]
    assert last.cell_type == "code"
    nodes = list(ast.walk(ast.parse(last.source)))
    asserted = [node for node in nodes if isinstance(node, ast.Assert)]
    compared = [node for node in nodes if isinstance(node, ast.Attribute) and node.attr == "assert_allclose"]
    assert len(asserted) + len(compared) >= 5
    assert compared


@pytest.mark.long_for(*(path.stem for path in NOTEBOOKS[:5] + NOTEBOOKS[6:]))
@each_notebook
def test_it_runs(path: Path, tmp_path: Path) -> None:
    """One of them here: ``make docs`` runs them all, and an exception in one ends it."""
    notebook = _read(path)
    _run(notebook, tmp_path)
    outputs = [output for cell in _code(notebook) for output in cell.outputs]
    assert not [output.text for output in outputs if output.output_type == "stream" and output.name == "stderr"]
    shown = [output.data for output in outputs if "data" in output]
    assert any("image/png" in data for data in shown)
    # a figure or a scene that is not shown leaves its name only
    assert not [data for data in shown if re.match(r"<\w*Figure|View\(", data.get("text/plain", "")) and len(data) == 1]
    assert not list(tmp_path.iterdir()), "a notebook leaves nothing behind"


@pytest.mark.long
def test_a_number_that_is_off_fails_the_run(tmp_path: Path) -> None:
    wrong = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("assert 1.70 == 1.71")])
    with pytest.raises(CellExecutionError, match="AssertionError"):
        _run(wrong, tmp_path)
