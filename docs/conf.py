"""Sphinx configuration: `make docs` builds the pages into build/docs, warnings are errors, nothing is fetched.

Pages are named in the table of contents of index.md; notebooks are picked up.
"""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path

from sphinx.application import Sphinx

import redundancy_pin

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from api_pages import write_pages  # noqa: E402 - it lies beside this file

project = "redundancy_pin"
author = "The redundancy_pin developers"
copyright = author
version = release = redundancy_pin.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_click", "mathml"]
html_math_renderer = "mathml"
exclude_patterns = ["pictures", "examples"]
suppress_warnings = ["ref.python"]  # an annotation that two classes of the same name fit links to one of them
highlight_language = "none"

myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_type_aliases = {name: name for name in ("Array", "ArrayLike", "BoolArray", "IntArray")}
napoleon_attr_annotations = False  # docstrings say shape and unit, which says more
smartquotes = False  # -- is part of options
napoleon_numpy_docstring = False
napoleon_use_ivar = True  # attributes of dataclasses are a list, not objects of their own
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 90

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
# system fonts lack letters with two dots, and would drop the dots: those come from the font of the formulas
html_theme_options = {
    "light_css_variables": {
        "font-stack": 'system-ui, "Segoe UI", Helvetica, Arial, sans-serif, Formulas',
        "font-stack--monospace": '"SFMono-Regular", Menlo, Consolas, "Liberation Mono", monospace, Formulas',
    }
}
html_title = f"redundancy_pin {release}"
html_show_copyright = False
html_copy_source = False

# Notebooks live at the top of the checkout and are executed where they are copied to; one that fails, fails the build.
nb_execution_mode = "force"  # what they show depends on the package, which a cache of notebooks does not look at
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True


def collect_notebooks(source: Path, target: Path) -> None:
    """Make a folder hold the notebooks of another one, with links to pages that lead from there."""
    target.mkdir(exist_ok=True)
    wanted = {path.name: path.read_text(encoding="utf-8") for path in source.glob("*.ipynb")}
    for path in target.glob("*.ipynb"):
        if path.name not in wanted:
            path.unlink()
    for name, text in wanted.items():
        copy, text = target / name, text.replace("](../docs/", "](../../")
        if not (copy.is_file() and copy.read_text(encoding="utf-8") == text):
            copy.write_text(text, encoding="utf-8")


def offer_kernel(folder: Path) -> None:
    """Make "python3" this interpreter, whatever kernels the user has; it tells of errors only."""
    kernel = folder / "kernels" / "python3" / "kernel.json"
    kernel.parent.mkdir(parents=True, exist_ok=True)
    launch = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}", "--log-level=40"]
    kernel.write_text(json.dumps({"argv": launch, "display_name": "Python 3", "language": "python"}), encoding="utf-8")
    os.environ["JUPYTER_PATH"] = os.pathsep.join(filter(None, (str(folder), os.environ.get("JUPYTER_PATH"))))


offer_kernel(HERE.parent / "build" / "jupyter")
write_pages(HERE / "reference" / "api" / "modules")
collect_notebooks(HERE.parent / "notebooks", HERE / "tutorials" / "notebooks")


def fill_in_contents(app: Sphinx, docname: str, source: list[str]) -> None:
    """Put the notebooks that are there in place of ``@notebooks@``."""
    notebooks = sorted(path.stem for path in (HERE / "tutorials" / "notebooks").glob("*.ipynb"))
    source[0] = source[0].replace("@notebooks@", "\n".join(f"notebooks/{name}" for name in notebooks))


def escape_bars(app: Sphinx, what: str, name: str, subject: object, options: object, lines: list[str]) -> None:
    """Keep |τ| in docstrings an absolute value: reStructuredText takes it for a substitution."""
    lines[:] = ["``".join(part if i % 2 else part.replace("|", r"\|") for i, part in enumerate(re.split("``", line)))
                for line in lines]  # fmt: skip


def escape_bars_of_options(app: Sphinx, command: object, lines: list[str]) -> None:
    """Keep |τ| in help texts an absolute value, and * a star; the bars of choices, such as GIF|MP4, need nothing."""
    lines[:] = [
        re.sub(r"\|(\w{1,2}\W?)\|", r"\\|\1\\|", line).replace(" *", r" \*").replace("'*", r"'\*") for line in lines
    ]


def shorten_types(
    app: Sphinx, what: str, name: str, subject: object, options: object, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Leave out the modules of types: signatures of dataclasses with default factories show them whole."""
    short = signature and re.sub(r"~(?:\w+\.)*(\w+)", r"\1", signature).replace("<factory>", "...")
    return short, returned


def setup(app: Sphinx) -> None:
    """Connect the hooks."""
    app.connect("source-read", fill_in_contents)
    app.connect("autodoc-process-docstring", escape_bars)
    app.connect("sphinx-click-process-options", escape_bars_of_options)
    app.connect("autodoc-process-signature", shorten_types)
