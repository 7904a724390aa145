"""XML of models: read with limits, so that a hostile file is refused before a parser chokes on it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path
from typing import cast
from xml.parsers import expat

from redundancy_pin.errors import ModelFileError, shortened
from redundancy_pin.io.reading import read_text

MOST_BYTES = 2_000_000
"""Size of a file: URDFs of humanoids have 0.5 MB. One tag with 4 MB of attributes keeps expat busy for a second."""

MOST_ELEMENTS = 20_000
"""Elements of a document; humanoids have some 5000. xacro needs a second for these."""

MOST_COMMENTS = 5_000
"""Comments and processing instructions: xacro looks for each that it removes among all its siblings."""

MOST_ATTRIBUTES = 100
"""Attributes of an element."""

DEEPEST = 100
"""Elements in elements: all readers that follow go down by recursion."""


FORMATS = {"robot": "a URDF", "mujoco": "an MJCF model of MuJoCo", "sdf": "an SDF model of Gazebo"}
"""What a file is, by its top element."""

_BEFORE_TOP = (("<?", "?>"), ("<!--", "-->"), ("<!", ">"))
_SPACE = re.compile(r"\s*")
_TAG = re.compile(r"<\s*([\w:.-]+)")


def format_of(text: str) -> str:
    """Return what a text is, if it is XML: one of ``FORMATS``, or by its top element; empty if it is no XML."""
    if not text.lstrip().startswith("<"):
        return ""
    place = _SPACE.match(text).end()  # type: ignore[union-attr]
    while begun := next((pair for pair in _BEFORE_TOP if text.startswith(pair[0], place)), None):
        end = text.find(begun[1], place)
        place = _SPACE.match(text, end + len(begun[1]) if end >= 0 else len(text)).end()  # type: ignore[union-attr]
    top = _TAG.match(text, place)
    return FORMATS.get(top[1], f"an XML file with <{shortened(top[1], 40)}> on top") if top else "an XML file"


class Element(ElementTree.Element):
    """An element that knows its line."""

    line: int = 0


def parsed(path: Path) -> Element:
    """Return the root element of an XML file.

    Raises:
        ModelFileError: missing file, broken XML, or more of it than a model may have.
    """
    return parsed_text(read_model(path), str(path))


def read_model(path: Path) -> str:
    """Return the text of a file of a model.

    Raises:
        ModelFileError: missing or unreadable file, no regular file, too large, or not UTF-8.
    """
    return read_text(path, ModelFileError, "The model ", largest=MOST_BYTES)


def parsed_text(text: str, where: str) -> Element:
    """Return the root element of a document.

    A document type is refused, whole: models need none, and entities make gigabytes of a few lines.

    Args:
        text: the document.
        where: what to call it in messages.

    Raises:
        ModelFileError: as ``parsed``.
    """
    builder = ElementTree.TreeBuilder(element_factory=Element)
    parser = expat.ParserCreate("utf-8", "}")
    parser.buffer_text = True
    depth = count = comments = 0

    def refuse(what: str, remedy: str) -> ModelFileError:
        line = parser.CurrentLineNumber
        return ModelFileError(f"{where}, line {line}: {what}.", remedy=remedy, path=where, line=line)

    def start(tag: str, attributes: Mapping[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        for amount, most, what in (
            (depth, DEEPEST, "levels of elements"),
            (count, MOST_ELEMENTS, "elements"),
            (len(attributes), MOST_ATTRIBUTES, "attributes of one element"),
        ):
            if amount > most:
                raise refuse(f"more than {most} {what}", "A model has no use for so many.")
        named = {_name(key): value for key, value in attributes.items()}
        element = builder.start(_name(tag), named)
        element.line = parser.CurrentLineNumber  # type: ignore[attr-defined]

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(_name(tag))

    def comment(*_: object) -> None:
        nonlocal comments
        comments += 1
        if comments > MOST_COMMENTS:
            raise refuse(f"more than {MOST_COMMENTS} comments", "Take some out.")

    def document_type(*_: object) -> None:
        raise refuse("it has a document type (DOCTYPE)", "Take it out: models may not define entities.")

    def declaration(version: str, encoding: str | None, standalone: int) -> None:
        # the text is read as UTF-8; of other encodings only those say the same that write ASCII as ASCII
        name = (encoding or "utf-8").lower()
        if name not in ("utf-8", "utf8") and (not text.isascii() or name.startswith(("utf", "ucs", "iso-10646"))):
            raise refuse(f"it says that it is written in {name[:40]!r}", "Save it as UTF-8, and say so.")

    parser.XmlDeclHandler = declaration
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    parser.CommentHandler = parser.ProcessingInstructionHandler = comment
    parser.StartDoctypeDeclHandler = document_type
    try:
        parser.Parse(text.encode("utf-8", "surrogatepass"), True)
        root = builder.close()
    except expat.ExpatError as error:
        raise ModelFileError(
            f"{where} is not well-formed XML: {error}.", remedy="Repair the file at that place.", path=where
        ) from error
    return cast("Element", root)


def _name(name: str) -> str:
    """Return a name as ElementTree writes it: {namespace}name."""
    return "{" + name if "}" in name else name
