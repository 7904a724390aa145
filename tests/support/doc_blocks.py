"""What the documentation runs: scripts, and fenced blocks of pages with the comments that say what to do with them."""

from __future__ import annotations

import importlib.util
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

FENCE = re.compile(r"^(`{3,}|:{3,})(.*)$")
MARK = re.compile(r"^<!-- (file|not run|raises|exit code): (.+) -->$")
LEAST_REASON = 12
"""Characters: a reason is a sentence, not a shrug."""


@dataclass(frozen=True)
class Block:
    """A fenced block.

    Attributes:
        page: where it stands.
        line: number of its first line of text.
        language: what stands behind the fence.
        text: what stands between the fences.
        marks: comments right in front of it: ``file`` it is written to, ``not run`` and why,
            ``raises`` an error of this name, ``exit code``.
    """

    page: str
    line: int
    language: str
    text: str
    marks: dict[str, str]

    @property
    def runs(self) -> bool:
        return "not run" not in self.marks

    @property
    def where(self) -> str:
        return f"{self.page}:{self.line}"

    @property
    def commands(self) -> list[str]:
        """The lines of a shell block, continued ones joined, comments left out."""
        joined = re.sub(r"\\\n\s*", "", self.text)
        return [line.strip() for line in joined.splitlines() if line.strip() and not line.lstrip().startswith("#")]


def blocks_of(path: Path, name: str) -> list[Block]:
    """Return the fenced blocks of a page in order; an indented or unclosed one is an error."""
    blocks: list[Block] = []
    marks: dict[str, str] = {}
    opened: tuple[str, str, int] | None = None
    lines = path.read_text(encoding="utf-8").splitlines()
    for number, line in enumerate(lines, start=1):
        fence = FENCE.match(line)
        if opened is None:
            assert not re.match(r"^\s+```", line), f"{name}:{number}: an indented fence is not looked at"
            if mark := MARK.match(line):
                marks[mark[1]] = mark[2]
            elif fence:
                opened = (fence[1], fence[2].strip(), number)
            elif line.strip():
                assert not marks, f"{name}:{number}: {marks} stands in front of no block"
        elif fence and fence[1] == opened[0] and not fence[2]:
            text = "\n".join(lines[opened[2] : number - 1]) + "\n"
            blocks.append(Block(name, opened[2] + 1, opened[1], text, marks))
            marks, opened = {}, None
    assert opened is None, f"{name}:{opened[2]}: never closed" if opened else ""
    return blocks


def example_script(path: Path) -> ModuleType:
    """Return a script of ``docs/examples`` as a module, without running its ``main``; it may import its neighbours."""
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
