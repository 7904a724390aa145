"""A report in Markdown as one HTML page: no network, no other file, no script."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import jinja2
from markdown_it import MarkdownIt
from markdown_it.common.utils import escapeHtml

from redundancy_pin.errors import OutputError

VERDICTS = {
    **dict.fromkeys(("reproduced", "met", "stands"), "good"),
    **dict.fromkeys(("reproduced:", "stands with conditions"), "partly"),
    **dict.fromkeys(("differs:", "missed", "does not stand"), "bad"),
}
"""Class of a cell by its text; a colon is followed by a condition or a reason."""


def html(markdown: str, folder: Path) -> str:
    """Return a report as one HTML page: its pictures, of the folder, embedded, links to other files as text."""
    renderer = MarkdownIt("commonmark", {"html": False}).enable("table")
    # rules of a renderer get the tokens, the index of theirs, options and an environment
    rules: dict[str, Callable[..., str]] = {
        "image": lambda tokens, index, *_: _image(folder / str(tokens[index].attrs["src"]), tokens[index].content),
        # no line break splits a working mode
        "text": lambda tokens, index, *_: re.sub(
            "([+\u2212]{2,})", r'<span class="mode">\1</span>', escapeHtml(tokens[index].content)
        ),
        "link_open": lambda *_: "",
        "link_close": lambda *_: "",
        "table_open": lambda *_: '<div class="scroll"><table>\n',
        "table_close": lambda *_: "</table></div>\n",
    }
    renderer.renderer.rules.update(rules)  # type: ignore[attr-defined]
    tokens = renderer.parse(markdown)
    headings: list[tuple[str, str]] = []
    title = "Report"
    for index, (token, inner) in enumerate(pairwise(tokens)):
        if token.type == "td_open":
            verdict, colon, _ = inner.content.partition(":")
            kind = VERDICTS.get(verdict + colon)
            token.attrs = {"class": kind} if kind else {}
        elif token.tag == "h1":
            title = inner.content or title
        elif token.type == "heading_open" and token.tag == "h2":
            headings.append((f"s{index}", inner.content))
            token.attrSet("id", f"s{index}")
    body = renderer.renderer.render(tokens, renderer.options, {})
    page = jinja2.Environment(loader=jinja2.PackageLoader("redundancy_pin.thesis", ""), autoescape=True)
    return page.get_template("page.html.j2").render(title=title, headings=headings, body=body)


def _image(path: Path, title: str) -> str:
    try:
        content = base64.b64encode(path.read_bytes()).decode("ascii")
    except OSError as error:
        raise OutputError(f"Cannot read {path}: {error.strerror or error}.", path=str(path)) from error
    return f'<img src="data:image/png;base64,{content}" alt="{escapeHtml(title)}" loading="lazy">'
