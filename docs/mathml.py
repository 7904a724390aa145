"""Sphinx extension: formulas as MathML, which browsers show by themselves. MathJax would be fetched from the net."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from docutils.utils.math import pick_math_environment
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx


def visit_math(translator: Any, node: nodes.math) -> None:
    """Write a formula in a line."""
    translator.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def visit_math_block(translator: Any, node: nodes.math_block) -> None:
    """Write a formula on a line of its own."""
    text = node.astext()
    translator.body.append('<div class="math">')
    translator.body.append(tex2mathml(f"\\begin{{{environment}}}{text}\\end{{{environment}}}", as_block=True)
                           if (environment := pick_math_environment(text)) == "align*" and "\\\\" in text
                           else tex2mathml(text, as_block=True))  # fmt: skip
    translator.body.append("</div>")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer."""
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_math_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
