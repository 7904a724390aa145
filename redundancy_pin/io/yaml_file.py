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

_LONGEST_KEY, _LONGEST_NUMBER = 200, 1000
"""Characters of a key, with those around it, whose line is kept; characters of a number."""

_TAG = "tag:yaml.org,2002:"
_SCALARS = {f"{_TAG}{kind}" for kind in ("null", "bool", "int", "float", "str")}
"""Tags of the scalars that a file may hold: no dates, sets, binary data, or objects of Python."""

_NOT_DECIMAL = re.compile(r"[-+]?0[0-9_]+$|.*:")
"""Numbers that are not what they look like: YAML 1.1 reads 010 as 8, 1:30 as 90, and 1:30.5 as 90.5."""

# libyaml is ten times as fast; builds of PyYAML without it do the same
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


@dataclass(frozen=True)
class YamlFile:
    """The content of a file, with the line of each entry.

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
        """Put file and line in front of errors of a declaration that are raised in the block.

        The line is the line of the key, or of the first value or key with the name, in the details of the error.
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
        error: type of the errors.
        what: kind of file, before its path in messages: "The problem ".
        tags: function that reads the text of a scalar with its own tag, such as ``!degrees 90``; its errors pass.

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
    builder = _Builder(path, error, tags)
    try:
        builder.require_bounded(text)
        node = yaml.compose(text, _Loader)
        return YamlFile(path, None if node is None else builder.value(node, "", 0), builder.lines)
    except yaml.MarkedYAMLError as fault:
        mark = fault.problem_mark or fault.context_mark
        if "nesting depth" in str(fault.problem):  # libyaml since 0.2.6 looks ahead for a key, over a thousand brackets
            raise builder.too_deep(mark) from fault
        lines = text.splitlines()
        if mark is not None and mark.line < len(lines) and lines[mark.line][mark.column : mark.column + 1] == "\t":
            raise builder.refused(mark, "a tab, where YAML allows spaces alone", "Put spaces in its place.") from fault
        reasons = ", ".join(part for part in (fault.context, fault.problem) if part)
        raise builder.refused(mark, f"not readable YAML: {reasons}", "Repair the file there.") from fault
    except yaml.YAMLError as fault:  # characters that YAML does not allow, such as NUL
        reasons = " ".join(str(fault).split())
        raise builder.refused(None, f"not readable YAML: {reasons}", "Repair the file.") from fault


class _Builder:
    """Makes plain data from PyYAML's nodes."""

    def __init__(self, path: str, error: type[RedundancyPinError], tags: Mapping[str, Callable[[str], Any]]) -> None:
        self.path, self.error, self.tags = path, error, tags
        self.lines: dict[str, int] = {}
        self.count = 0
        self.around: list[yaml.Node] = []

    def require_bounded(self, text: str) -> None:
        """Refuse what would take PyYAML long, or its stack: deep nesting, many values, and definitions of tags."""
        if definition := re.search(r"^%TAG", text, re.MULTILINE):
            line = text.count("\n", 0, definition.start()) + 1
            raise self.error(f"{self.path}, line {line}: it defines a tag.", remedy="Remove the line.", path=self.path)
        depth = count = 0
        for event in yaml.parse(text, _Loader):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            count += isinstance(event, yaml.NodeEvent)
            if depth > DEEPEST or count > MOST_VALUES:
                raise self.too_deep(event.start_mark) if depth > DEEPEST else self.too_many(event.start_mark)

    def value(self, node: yaml.Node, key: str, depth: int) -> Any:
        """Return the data of a node at ``key``."""
        self.count += 1
        if self.count > MOST_VALUES:
            raise self.too_many(node.start_mark)
        if node in self.around:
            raise self.refused(node.start_mark, "a value holds itself through its alias", "Write it without the alias.")
        if depth > DEEPEST:  # by aliases
            raise self.too_deep(node.start_mark)
        if key and len(key) <= _LONGEST_KEY:
            self.lines.setdefault(key, node.start_mark.line + 1)
        if isinstance(node, yaml.ScalarNode):
            return self.scalar(node, key)
        if node.tag not in (f"{_TAG}seq", f"{_TAG}map", "!"):
            raise self.strange(node, key)
        self.around.append(node)
        if isinstance(node, yaml.MappingNode):
            data: Any = self.mapping(node, key, depth)
        else:
            data = [self.value(each, f"{key}[{number}]", depth + 1) for number, each in enumerate(node.value)]
        self.around.pop()
        return data

    def mapping(self, node: yaml.MappingNode, key: str, depth: int) -> dict[str, Any]:
        """Return a mapping, with what ``<<`` merges into it behind its own keys."""
        values: dict[str, Any] = {}
        merged: dict[str, Any] = {}
        first: dict[str, int] = {}
        for name_node, value_node in node.value:
            mark = name_node.start_mark
            is_merge = name_node.tag == f"{_TAG}merge"
            name = "<<" if is_merge else self.value(name_node, "", depth + 1)
            if not isinstance(name, str):
                kind = {list: "a list", dict: "a mapping", bool: "a truth value", type(None): "nothing"}
                message = f"the key {shown(name)} is not text, but {kind.get(type(name), 'a number')}"
                raise self.refused(mark, message, "Put it into quotes.")
            if name in first and (is_merge or values.get(name, name) is not None):  # an empty one says nothing
                message = f"the key {shown(name)} was given in line {first[name]} already"
                raise self.refused(mark, message, "Keep one of the two.", key=name)
            first[name] = mark.line + 1
            within = (f"{key}.{name}" if key else name)[: _LONGEST_KEY + 1]
            if len(within) <= _LONGEST_KEY:
                self.lines[within] = mark.line + 1
            value = self.value(value_node, within, depth + 1)
            if is_merge:
                merged = self.merge(value, mark)
                self.lines.update({f"{key}.{entry}": mark.line + 1 for entry in merged})
            else:
                values[name] = value
        return {**merged, **values}

    def merge(self, value: Any, mark: Any) -> dict[str, Any]:
        """Return what ``<<`` adds to a mapping: of several the first wins."""
        parts = value if isinstance(value, list) else [value]
        if not all(isinstance(part, dict) for part in parts):
            message = f"`<<` merges {shown(value)}, which is no mapping"
            raise self.refused(mark, message, "Name the anchor of a mapping: <<: *anchor.")
        return {name: entry for part in reversed(parts) for name, entry in part.items()}

    def scalar(self, node: yaml.ScalarNode, key: str) -> Any:
        """Return text, a number, a truth value or None."""
        if node.tag in self.tags:
            return self.tags[node.tag](node.value)
        if node.tag in (f"{_TAG}str", f"{_TAG}merge", "!"):
            return node.value
        if node.tag not in _SCALARS:
            raise self.strange(node, key)
        where = f"`{key}` is" if key else "there is"
        remedy = "Write a decimal number, or put text into quotes."
        if len(node.value) > _LONGEST_NUMBER:
            raise self.refused(node.start_mark, f"{where} a number of {len(node.value)} digits", remedy)
        if node.tag in (f"{_TAG}int", f"{_TAG}float") and _NOT_DECIMAL.match(node.value):
            message = f"{where} {node.value}, which YAML does not read as a decimal number"
            raise self.refused(node.start_mark, message, remedy)
        try:
            return yaml.constructor.SafeConstructor().construct_object(node)
        except (ValueError, LookupError) as fault:  # !!int of a word
            raise self.strange(node, key) from fault

    def strange(self, node: yaml.Node, key: str) -> RedundancyPinError:
        what = f"{shown(node.value)}, " if isinstance(node.value, str) and node.value else ""
        where = f"`{key}` is" if key else "there is"
        message = f"{where} {what}which YAML reads as {shown(node.tag.removeprefix(_TAG))[1:-1]}"
        remedy = "Put it into quotes, or write a number, text, list or mapping."
        return self.refused(node.start_mark, message, remedy)

    def too_deep(self, mark: Any) -> RedundancyPinError:
        return self.refused(mark, f"values are nested more than {DEEPEST} deep", "Flatten the file.")

    def too_many(self, mark: Any) -> RedundancyPinError:
        message = f"the file has more than {MOST_VALUES} values and keys, aliases counted as often as they are used"
        return self.refused(mark, message, "Use fewer.")

    def refused(self, mark: Any, message: str, remedy: str, **details: object) -> RedundancyPinError:
        where = self.path if mark is None else f"{self.path}, line {mark.line + 1}, column {mark.column + 1}"
        return self.error(f"{where}: {message}.", remedy=remedy, path=self.path, **details)
