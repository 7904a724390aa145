"""XML of models: read with limits, so that a hostile file is refused before a parser chokes on it; elements strictly.

URDF (``urdf_parts``), SDF (``sdf_frames``) and MJCF before MuJoCo reads it (``mjcf_compiled``) share this layer. What
is not a number, is there twice or is misspelt is an error with its file and line.
"""

from __future__ import annotations

import math
import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import ClassVar, NoReturn, TypeVar, cast
from xml.parsers import expat

import numpy as np

from redundancy_pin.arrays import LARGEST, Array
from redundancy_pin.errors import ModelFileError, did_you_mean, shortened
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


def remedy_of_format(found: str) -> str:
    """Return the remedy for a file whose content does not fit its name; ``found`` as of ``format_of``."""
    if not found or found in FORMATS.values():
        return "Models are read by their names: call it .urdf, .xacro, .xml, .mjcf or .sdf."
    return "Convert it to URDF, MJCF or SDF."


_BEFORE_TOP = (("<?", "?>"), ("<!--", "-->"), ("<!", ">"))
_SPACE = re.compile(r"\s*")
_TAG = re.compile(r"<\s*([\w:.-]+)")


def format_of(text: str) -> str:
    """Return what a text is, if it is XML: one of ``FORMATS``, or by its top element; empty if it is no XML."""
    place = _SPACE.match(text).end()  # type: ignore[union-attr]
    if not text.startswith("<", place):
        return ""
    while begun := next((pair for pair in _BEFORE_TOP if text.startswith(pair[0], place)), None):
        end = text.find(begun[1], place)
        place = _SPACE.match(text, end + len(begun[1]) if end >= 0 else len(text)).end()  # type: ignore[union-attr]
    top = _TAG.match(text, place)
    return FORMATS.get(top[1], f"an XML file with <{shortened(top[1], 40)}> on top") if top else "an XML file"


class Element(ElementTree.Element):
    """An element that knows its line."""

    line: int = 0


def parsed(path: Path) -> Element:
    """Return the root element of an XML file; see ``parsed_text``.

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
    """Return the root element of a document, with the names that it has there: namespaces are not resolved.

    Gazebo, MuJoCo, Drake and urdfdom read names so, by tinyxml2: prefixes may be bound to no namespace, as in 8 of the
    44 example worlds of Gazebo that have joints. A document type is refused, whole: models need none, and entities make
    gigabytes of a few lines. What else tinyxml2 reads and the standard does not allow is read too (``_mended``).

    Args:
        text: the document.
        where: its name for messages.

    Raises:
        ModelFileError: as ``parsed``.
    """
    try:
        return _parsed_strictly(text, where)
    except expat.ExpatError as error:
        try:
            return _parsed_strictly(_mended(text), where)
        except expat.ExpatError:
            raise ModelFileError(
                f"{where} is not well-formed XML: {error}.", remedy="Repair the file at that place.", path=where
            ) from error


def _mended(text: str) -> str:
    """Return a text without blanks before the declaration and "--" in comments, line by line the same."""
    text = re.sub(r"^(\s+)<\?xml[^<>]*\?>", r"\1", text)
    parts, place = list[str](), 0
    while (begin := text.find("<!--", place)) >= 0 and (end := text.find("-->", begin + 4)) >= 0:
        parts += [text[place : begin + 4], text[begin + 4 : end].replace("-", "=")]
        place = end
    return "".join(parts) + text[place:]


def _parsed_strictly(text: str, where: str) -> Element:
    """Return the root element of a document that is XML."""
    builder = ElementTree.TreeBuilder(element_factory=Element)
    parser = expat.ParserCreate("utf-8")
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
        element = builder.start(tag, dict(attributes))
        element.line = parser.CurrentLineNumber  # type: ignore[attr-defined]

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

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
    parser.Parse(text.encode("utf-8", "surrogatepass"), True)
    return cast("Element", builder.close())


# --- elements, read strictly -----------------------------------------------------------------------------------------


_P = TypeVar("_P", bound="Part")

DRAKE = "drake:"
"""Prefix of the elements that Drake adds."""

ZEROS = ("", "0", "0.0", "false")
"""Texts of elements and attributes that change nothing."""

LONGEST_NAME = 255
"""Characters of a name of a link or joint."""

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


@lru_cache(maxsize=256)  # every element of an included file asks
def _seen_from(top: Path, path: Path) -> str:
    return os.path.relpath(path.resolve(), top.resolve().parent)


@dataclass(frozen=True)
class Part:
    """An element, the file that it is in, and the link or joint that it belongs to: for messages and their details.

    It is read strictly: a text that is not a number, an element that is there twice or is misspelt is an error with
    file and line.

    Attributes:
        element: the element.
        path: the file that it is in.
        owner: what messages call the link, joint or file that it belongs to.
        details: of errors.
        top: the file that includes the other ones; None if there is one file only.
    """

    element: Element
    path: Path
    owner: str
    details: Mapping[str, str] = field(default_factory=dict)
    top: Path | None = None
    remedy: ClassVar[str] = "Correct the file."
    attributes_of: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    """By element, the attributes that its format knows: one that is nearly called so is an error."""

    def refuse(self, message: str, remedy: str = "", **details: object) -> NoReturn:
        """Refuse the file, at the line of the element."""
        line = self.element.line
        place = f"line {line}" + (" of what xacro makes of it" if self.path.suffix == ".xacro" else "")
        is_named = re.search(rf"(?<![\w/.-]){re.escape(self.file)}", message)
        raise ModelFileError(
            f"{message} ({place if is_named else f'{self.file}, {place}'}).",
            remedy=remedy or self.remedy,
            path=str(self.path),
            line=line,
            **self.details,
            **details,
        )

    @property
    def file(self) -> str:
        """The name of the file for messages: of an included file its path from the folder of the top file."""
        if self.top is None or self.path == self.top:
            return self.path.name
        return _seen_from(self.top, self.path)

    @property
    def tag(self) -> str:
        """The name of the element, with its prefix."""
        return str(self.element.tag)

    @property
    def place(self) -> str:
        """The element and its line, for messages."""
        return f"<{self.tag.rpartition(':')[2]}> in line {self.element.line}"

    @property
    def attributes(self) -> Mapping[str, str]:
        """The attributes of the element."""
        return self.element.attrib

    def children(self, tag: str) -> Iterator[Element]:
        """Give the elements of that name in the element."""
        return (part for part in self.element if part.tag == tag and isinstance(part, Element))

    def parts(self: _P, tag: str = "") -> list[_P]:
        """Return the elements in the element, of one name or all, each named by itself in messages."""
        found = [each for each in self.element if isinstance(each, Element) and tag in ("", each.tag)]
        return [self._named_by_itself(each) for each in found]

    def deep(self: _P, tag: str) -> list[_P]:
        """Return the elements of that name at any depth in the element."""
        return [self._named_by_itself(each) for each in self.element.iter(tag) if isinstance(each, Element)]

    def _named_by_itself(self: _P, element: Element) -> _P:
        label = str(element.tag).rpartition(":")[2]
        name = f" {element.get('name', '')!r}" if element.get("name") else ""
        return replace(self, element=element, owner=f"The <{label}>{name} of {self.file}", details={})

    def name(self) -> str:
        """Return the name of the element.

        Raises:
            ModelFileError: none, one that is blank, or one that is too long.
        """
        name = self.element.get("name", "")
        if not name or not name.isprintable() or name != name.strip():
            self.refuse(f"{self.owner} has the name {shortened(repr(self.element.get('name')))}", "Give it one.")
        if len(name) > LONGEST_NAME:
            self.refuse(f"{self.owner} has a name of {len(name)} characters", f"There may be {LONGEST_NAME}.")
        return name

    def text_of(self, key: str) -> str:
        """Return an attribute, empty if left out."""
        return self.element.get(key, "").strip()

    def content(self) -> str:
        """Return the text in the element."""
        return (self.element.text or "").strip()

    def one(self: _P, tag: str) -> _P | None:
        """Return a part of which there is at most one.

        Raises:
            ModelFileError: more of them, or an attribute that is nearly, but not quite, one that is left out.
        """
        parts = [replace(self, element=element) for element in self.children(tag)]
        if len(parts) > 1:
            parts[1].refuse(f"{self.owner} has <{tag}> {len(parts)} times")
        known = self.attributes_of.get(tag, ())
        for key in parts[0].element.attrib if parts and known else ():
            left_out = [each for each in known if each not in parts[0].element.attrib]
            if key not in known and (hint := did_you_mean(key.lower(), left_out)):
                parts[0].refuse(f"{self.owner} has <{tag}> with the attribute {shortened(key)!r}", hint.strip())
        return parts[0] if parts else None

    def required(self: _P, tag: str) -> _P:
        """Return a part that has to be there."""
        return self.one(tag) or self.refuse(f"{self.owner} has no {tag}")

    def number(self, key: str, what: str = "", most: float = LARGEST) -> float:
        """Return the number of an attribute."""
        text = self.element.get(key)
        number = _as_number((text or "").strip(), most)
        if number is None:
            shown = text if text is None else shortened(text)
            self.refuse(f"{self.owner} has the {what or key} {shown!r}, which is not a finite number")
        return number

    def numbers(self, text: str, count: int, what: str) -> Array:
        """Return the (count,) numbers of a text."""
        numbers = [_as_number(part, LARGEST) for part in text.split()]
        if len(numbers) != count or None in numbers:
            wanted = {1: "one finite number", 3: "three finite numbers"}.get(count, f"{count} finite numbers")
            remedy = "Write numbers with blanks between them."
            self.refuse(f"{self.owner} has {what} {shortened(text)!r}, which is not {wanted}", remedy)
        return np.array(numbers, dtype=float)

    def triple(self, key: str, what: str) -> Array:
        """Return the (3,) numbers of an attribute."""
        return self.numbers(self.element.get(key, ""), 3, what)


def _as_number(text: str, most: float) -> float | None:
    number = float(text) if _NUMBER.fullmatch(text) else math.nan
    return number if abs(number) <= most else None
