"""Sphinx extension: formulas as MathML, which browsers show by themselves. MathJax would be fetched from the net."""

from __future__ import annotations

import html
import re
from typing import Any
from xml.etree import ElementTree

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx

ACCENTS = "˙¨^~¯"


def mathml(formula: str, *, block: bool) -> str:
    """Return a formula as MathML.

    Args:
        formula: in LaTeX.
        block: whether it stands on a line of its own.
    """
    text = tex2mathml(formula, as_block=block).replace(' xmlns="http://www.w3.org/1998/Math/MathML"', "")
    tree = ElementTree.fromstring(re.sub(r"&(?!lt;|gt;|amp;)\w+;", lambda match: html.unescape(match[0]), text))
    for element in list(tree.iter("munderover")):
        base, index, above = element
        if (above.text or "") in ACCENTS:  # the index of a dotted letter belongs beside it, not under it
            dotted = ElementTree.Element("mover")
            dotted.extend([base, above])
            element.tag = "msub"
            element[:] = [dotted, index]
    return ElementTree.tostring(tree, encoding="unicode")


def visit_math(translator: Any, node: nodes.math) -> None:
    """Write a formula in a line."""
    translator.body.append(mathml(node.astext(), block=False))
    raise nodes.SkipNode


def visit_math_block(translator: Any, node: nodes.math_block) -> None:
    """Write a formula on a line of its own."""
    translator.body.append(f"<div>{mathml(node.astext(), block=True)}</div>")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer."""
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_math_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
