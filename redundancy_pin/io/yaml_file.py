"""The one reader of YAML: data only, of bounded size, with the line of every key for messages."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from redundancy_pin.errors import DeclarationError, RedundancyPinError, shown
from redundancy_pin.io.reading import read_text

LARGEST_FILE = 1 << 20
"""Bytes; declarations and problems have a few thousand."""

DEEPEST = 50
"""Levels of lists and mappings inside each other."""

MOST_VALUES = 20_000
"""Values and keys in a file, aliases counted as often as they are used: a few lines of them stand for billions."""

_LONGEST_INTEGER = 1000
"""Characters; Python does not write out integers of more than 4300 digits."""

_LONGEST_KEY = 200
"""Characters of a key, with those around it, whose line is kept."""

_TAG = "tag:yaml.org,2002:"
_KINDS = ("null", "bool", "int", "float", "str")
"""Kinds of scalars that a file may hold. Dates, sets, binary data and objects of Python are none of them."""

_MERGE = "<<"

# libyaml is ten times as fast; builds of PyYAML without it do the same
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


@dataclass(frozen=True)
class YamlFile:
    """The content of a file, and where it stands.

    Attributes:
        path: the file, as given.
        data: numbers, truth values, text, None, lists, and mappings whose keys are text.
        lines: number of the line of each entry, by the key that messages name it with: ``carriers[0].speed``.
    """

    path: str
    data: Any
    lines: Mapping[str, int]

    def place(self, key: str) -> str:
        """Return file and line of a key, or of the nearest one around it that is in the file."""
        while key not in self.lines and key:
            key = re.sub(r"(?:^|\.|\[)[^.\[]*$", "", key)
        return f"{self.path}, line {self.lines[key]}" if key else self.path

    @contextmanager
    def naming(self) -> Iterator[None]:
        """Errors of a declaration raised in the block begin with the file and the line of what they are about.

        It is the line of the key that the error names, or that of the first value or key with the name in the error.
        """
        try:
            yield
        except DeclarationError as error:
            named = error.details.get("name")
            key = str(
                error.details.get("key") or next((key for key, text in _texts("", self.data) if text == named), "")
            )
            message = f"{self.place(key)}: {error.message}"
            raise DeclarationError(message, remedy=error.remedy, **error.details) from error


def _texts(key: str, data: Any) -> Iterator[tuple[str, str]]:
    """Yield the texts among data, and keys of mappings, each with the key that messages name it with."""
    if isinstance(data, str):
        yield key, data
    elif isinstance(data, list):
        for number, each in enumerate(data):
            yield from _texts(f"{key}[{number}]", each)
    elif isinstance(data, dict):
        for name, each in data.items():
            inner = f"{key}.{name}" if key else name
            yield inner, name
            yield from _texts(inner, each)


def read_yaml(
    path: str | Path, error: type[RedundancyPinError], what: str = "", tags: Mapping[str, Callable[[str], Any]] = {}
) -> YamlFile:
    """Read a YAML file. Nothing in it is executed.

    Args:
        path: the file, UTF-8.
        error: what is raised.
        what: what it is, before its path in messages: "The problem ".
        tags: what the text of a scalar with a tag of one's own, such as ``!degrees 90``, stands for; as it raises.

    Raises:
        RedundancyPinError: of the given kind, with the line: no file, too large, not UTF-8, broken YAML, a key twice in
            one mapping (unless the first is empty), keys that are not text, nesting or aliases beyond the limits,
            or a value that is neither text nor a number, truth value, list or mapping (such as a date).
    """
    return parse_yaml(read_text(path, error, what, largest=LARGEST_FILE), str(path), error, tags)


def parse_yaml(
    text: str, path: str, error: type[RedundancyPinError], tags: Mapping[str, Callable[[str], Any]] = {}
) -> YamlFile:
    """Return the content of YAML text; ``path`` names it in messages. Errors as ``read_yaml``."""
    reader = _Reader(path, error, tags)
    try:
        _require_no_tags(text, path, error)
        reader.events = _Loader(text)
        try:
            return YamlFile(path, reader.document(), reader.lines)
        finally:
            reader.events.dispose()
    except yaml.MarkedYAMLError as fault:
        mark = fault.problem_mark or fault.context_mark
        if "nesting depth" in str(fault.problem):  # libyaml since 0.2.6 looks ahead for a key, over a thousand brackets
            raise reader.too_deep(mark) from fault
        lines = text.splitlines()
        if mark is not None and mark.line < len(lines) and lines[mark.line][mark.column : mark.column + 1] == "\t":
            raise reader.refused(mark, "a tab, where YAML allows spaces alone", "Put spaces in its place.") from fault
        reasons = ", ".join(part for part in (fault.context, fault.problem) if part)
        raise reader.refused(mark, f"not readable YAML: {reasons}", "Repair the file there.") from fault
    except yaml.YAMLError as fault:  # characters that YAML does not allow, such as NUL
        reasons = " ".join(str(fault).split())
        raise reader.refused(None, f"not readable YAML: {reasons}", "Repair the file.") from fault


def _require_no_tags(text: str, path: str, error: type[RedundancyPinError]) -> None:
    """Refuse definitions of tags, none of which is known, and on thousands of which libyaml spends minutes."""
    definition = re.search(r"^%TAG", text, re.MULTILINE)
    if definition:
        line = text.count("\n", 0, definition.start()) + 1
        raise error(f"{path}, line {line}: it defines a tag.", remedy="Leave the line out.", path=path)


class _Reader:
    """Makes values from the parser's events one by one, so that every limit holds before anything is made."""

    events: Any

    def __init__(self, path: str, error: type[RedundancyPinError], tags: Mapping[str, Callable[[str], Any]]) -> None:
        self.path, self.error, self.tags = path, error, tags
        self.lines: dict[str, int] = {}
        self.anchors: dict[str, tuple[Any, int] | None] = {}  # value and count of values; None while it is being read
        self.count = 0

    def document(self) -> Any:
        events = self.events
        events.get_event()  # the stream
        if events.check_event(yaml.StreamEndEvent):
            return None
        events.get_event()  # the document
        value = self.value("", 0)
        events.get_event()
        if not events.check_event(yaml.StreamEndEvent):
            raise self.refused(events.peek_event().start_mark, "a second document begins", "Keep one document a file.")
        return value

    def value(self, key: str, depth: int) -> Any:
        event = self.events.get_event()
        if key and len(key) <= _LONGEST_KEY:
            self.lines[key] = event.start_mark.line + 1
        if isinstance(event, yaml.AliasEvent):
            return self.alias(event)
        if depth > DEEPEST:
            raise self.too_deep(event.start_mark)
        before = self.count
        self.add(1, event)
        if event.anchor is not None:
            self.anchors[event.anchor] = None
        if isinstance(event, yaml.SequenceStartEvent):
            self.require_tag(event, "seq", key)
            value: Any = self.sequence(key, depth)
        elif isinstance(event, yaml.MappingStartEvent):
            self.require_tag(event, "map", key)
            value = self.mapping(key, depth)
        else:
            value = self.scalar(event, key)
        if event.anchor is not None:
            self.anchors[event.anchor] = value, self.count - before
        return value

    def sequence(self, key: str, depth: int) -> list[Any]:
        values: list[Any] = []
        while not self.events.check_event(yaml.SequenceEndEvent):
            values.append(self.value(f"{key}[{len(values)}]", depth + 1))
        self.events.get_event()
        return values

    def mapping(self, key: str, depth: int) -> dict[str, Any]:
        values: dict[str, Any] = {}
        merged: dict[str, Any] = {}
        first: dict[str, int] = {}
        while not self.events.check_event(yaml.MappingEndEvent):
            event = self.events.peek_event()
            line = event.start_mark.line + 1
            is_merge = isinstance(event, yaml.ScalarEvent) and event.value == _MERGE and event.implicit[0]
            name = self.value("", depth + 1)
            if not isinstance(name, str):
                remedy = "Put it into quotes."
                raise self.refused(event.start_mark, f"the key {shown(name)} is not text, but {_kind(name)}", remedy)
            if name in first and (is_merge or values.get(name, name) is not None):  # an empty one says nothing
                message = f"the key {shown(name)} was given in line {first[name]} already"
                raise self.refused(event.start_mark, message, "Keep one of the two.", key=name)
            first[name] = line
            # cut, or long keys inside long keys would fill the memory
            within = (f"{key}.{name}" if key else name)[: _LONGEST_KEY + 1]
            value = self.value(within, depth + 1)
            if len(within) <= _LONGEST_KEY:
                self.lines[within] = line
            if is_merge:
                merged = self.merge(value, event)
            else:
                values[name] = value
            self.lines.update({f"{key}.{name}": line for name in merged} if is_merge else {})
        self.events.get_event()
        return {**merged, **values}

    def merge(self, value: Any, event: Any) -> dict[str, Any]:
        """Return what ``<<`` adds to a mapping: of several the first wins."""
        parts = value if isinstance(value, list) else [value]
        if not all(isinstance(part, dict) for part in parts):
            message = f"`<<` merges {shown(value)}, which is no mapping"
            raise self.refused(event.start_mark, message, "Name the anchor of a mapping: <<: *anchor.")
        return {name: entry for part in reversed(parts) for name, entry in part.items()}

    def alias(self, event: Any) -> Any:
        if event.anchor not in self.anchors:
            raise self.refused(event.start_mark, f"there is no anchor {shown(event.anchor)} before it", "Define it.")
        known = self.anchors[event.anchor]
        if known is None:
            raise self.refused(event.start_mark, f"{shown(event.anchor)} holds itself", "Write it out.")
        value, count = known
        self.add(count, event)
        return value

    def add(self, count: int, event: Any) -> None:
        self.count += count
        if self.count > MOST_VALUES:
            message = f"the file has more than {MOST_VALUES} values and keys, aliases counted as often as they are used"
            raise self.refused(event.start_mark, message, "Use fewer.")

    def scalar(self, event: Any, key: str) -> Any:
        tag = event.tag
        if tag in self.tags:
            return self.tags[tag](event.value)
        if tag is None or tag == "!":
            tag = self.events.resolve(yaml.ScalarNode, event.value, event.implicit)
            if tag == f"{_TAG}merge":
                tag = f"{_TAG}str"
        kind = tag.removeprefix(_TAG)
        if kind not in _KINDS:
            raise self.strange(event, tag, key)
        if kind == "str":
            return event.value
        if kind in ("int", "float"):
            self.require_decimal(event, key, kind)
        try:
            return self.events.construct_object(yaml.ScalarNode(tag, event.value, event.start_mark, event.end_mark))
        except (ValueError, LookupError) as fault:  # !!int of a word
            raise self.strange(event, tag, key) from fault

    def require_decimal(self, event: Any, key: str, kind: str) -> None:
        """Refuse numbers that are not what they look like: YAML 1.1 reads 010 as 8, 1:30 as 90, and 1:30.5 as 90.5."""
        digits = event.value.lstrip("+-").replace("_", "")
        where = f"`{key}` is" if key else "there is"
        if kind == "int" and len(digits) > _LONGEST_INTEGER:
            message = f"{where} an integer of {len(digits)} digits"
        elif ":" in digits or (kind == "int" and re.match(r"0[0-9]", digits)):
            message = f"{where} {event.value}, which YAML does not read as a decimal number"
        else:
            return
        raise self.refused(event.start_mark, message, "Write a decimal number, or put text into quotes.")

    def require_tag(self, event: Any, kind: str, key: str) -> None:
        if event.tag not in (None, "!", f"{_TAG}{kind}"):
            raise self.strange(event, event.tag, key)

    def strange(self, event: Any, tag: str, key: str) -> RedundancyPinError:
        value = getattr(event, "value", "")
        what = f"{shown(value)}, " if value else ""
        where = f"`{key}` is" if key else "there is"
        message = f"{where} {what}which YAML reads as {shown(tag.removeprefix(_TAG))[1:-1]}"
        return self.refused(event.start_mark, message, "Put it into quotes, or write a number, text, list or mapping.")

    def too_deep(self, mark: Any) -> RedundancyPinError:
        return self.refused(mark, f"values are nested more than {DEEPEST} deep", "Flatten the file.")

    def refused(self, mark: Any, message: str, remedy: str, **details: object) -> RedundancyPinError:
        where = self.path if mark is None else f"{self.path}, line {mark.line + 1}, column {mark.column + 1}"
        return self.error(f"{where}: {message}.", remedy=remedy, path=self.path, **details)


def _kind(value: object) -> str:
    kinds = {bool: "a truth value", int: "a number", float: "a number", type(None): "nothing", list: "a list"}
    return kinds.get(type(value), "a mapping")
