"""Which tests reach which line of the package, and how long they take: what mutants are judged by.

``python tests/support/reached.py [test files]`` runs tests once, each file in a process of its own, so that what one
has cached hides no line from another. The answers are kept in ``build/reached``; files that have not changed since are
not asked again.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import json
import os
import pkgutil
import sys
import tempfile
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any, NoReturn

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "redundancy_pin"
KEPT = ROOT / "build" / "reached"
CORES = int(os.environ.get("JOBS", os.cpu_count() or 1))

ELSEWHERE = ("fuzz", "engines", "visualisation", "examples", "test_docs.py", "test_notebooks.py", "test_packaging.py")
"""Tests that judge no formula of the rooms, or take minutes to."""

LIBRARIES = (
    "numpy", "scipy.integrate", "scipy.interpolate", "scipy.linalg", "scipy.optimize", "scipy.spatial.transform",
    "pinocchio", "yaml", "pydantic", "click", "rich.table", "jinja2", "xacro",
    "xacrodoc", "casadi",
)  # fmt: skip
"""What the package and its tests import: once, before the forks. (Not hypothesis: pytest wants to see it imported.)"""

QUIET = ["-q", "-p", "no:xdist", "-p", "no:cacheprovider", "-p", "no:randomly"]
"""Options of pytest in a fork."""


def import_libraries() -> None:
    """Import what the package imports, and not the package: each fork imports that anew."""
    for library in LIBRARIES:
        importlib.import_module(library)
    if "redundancy_pin" in sys.modules:
        raise SystemExit("The package is loaded already: its copies would not be.")


def _import_package() -> None:
    """Import all of the package once, before the forks: what only runs then is reached by no test in particular."""
    sys.path.insert(0, str(ROOT))
    package = importlib.import_module("redundancy_pin")
    for module in pkgutil.walk_packages(package.__path__, "redundancy_pin."):
        with contextlib.suppress(ImportError):
            importlib.import_module(module.name)


def test_files() -> list[str]:
    """Return the files with tests that may judge a mutant."""
    files = (path.relative_to(ROOT) for path in sorted((ROOT / "tests").rglob("test_*.py")))
    return [path.as_posix() for path in files if not set(ELSEWHERE) & set(path.parts)]


@cache
def fingerprint(path: Path) -> str:
    """Return what changes with the content of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _kept(test_file: str) -> Path:
    return KEPT / (test_file.removeprefix("tests/").replace("/", ".") + ".json")


class _Contexts:
    """Tells the coverage which test runs, and notes down how long it takes."""

    def __init__(self, coverage: Any) -> None:
        self.coverage = coverage
        self.seconds: dict[str, float] = {}

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Any:
        self.coverage.switch_context(item.nodeid)
        start = os.times()
        try:
            return (yield)
        finally:
            self.seconds[item.nodeid] = round(sum(os.times()[:4]) - sum(start[:4]), 2)
            self.coverage.switch_context("")


def _in_child(test_file: str) -> NoReturn:
    from coverage import Coverage

    code = 99
    try:
        tempfile.tempdir = None
        null = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(null, stream)
        os.environ["COVERAGE_CORE"] = "ctrace"  # the one that knows of contexts
        coverage = Coverage(data_file=None, source=[str(PACKAGE)], config_file=False, messages=False)
        contexts = _Contexts(coverage)
        coverage.start()
        code = int(pytest.main([*QUIET, test_file], plugins=[contexts]))
        coverage.stop()
        data, names = coverage.get_data(), ["", *contexts.seconds]
        number = {name: i for i, name in enumerate(names)}
        lines: dict[str, list[list[list[int]]]] = {}
        for file in data.measured_files():
            sets: dict[tuple[int, ...], list[int]] = {}
            for line, reached in data.contexts_by_lineno(file).items():
                sets.setdefault(tuple(sorted(number[name] for name in reached)), []).append(line)
            lines[Path(file).relative_to(PACKAGE).as_posix()] = [[list(tests), where] for tests, where in sets.items()]
        answer = {"test": fingerprint(ROOT / test_file), "seconds": contexts.seconds, "lines": lines}
        answer["package"] = {name: fingerprint(PACKAGE / name) for name in lines}
        KEPT.mkdir(parents=True, exist_ok=True)
        _kept(test_file).write_text(json.dumps(answer), encoding="utf-8")
    finally:
        os._exit(code)


def up_to_date(test_file: str) -> bool:
    """Return whether a file's tests have been asked since it, or what they reach, was changed."""
    path = _kept(test_file)
    if not path.exists():
        return False
    facts = json.loads(path.read_text(encoding="utf-8"))
    now = {name: fingerprint(PACKAGE / name) if (PACKAGE / name).exists() else "" for name in facts["package"]}
    return bool(facts["test"] == fingerprint(ROOT / test_file) and facts["package"] == now)


@cache
def _answers() -> dict[str, dict[str, Any]]:
    answers = {file: _kept(file) for file in test_files()}
    return {file: json.loads(path.read_text(encoding="utf-8")) for file, path in answers.items() if path.exists()}


def tests_reaching(name: str, lines: Iterable[int]) -> tuple[dict[str, float], dict[str, float]]:
    """Return the tests that execute one of some lines of a file of the package, and the others of their files.

    Each with its seconds. Where the file of the package has changed since, any of its lines counts.
    """
    wanted, times, beside = set(lines), {}, {}
    for answer in _answers().values():
        same = answer["package"].get(name) == fingerprint(PACKAGE / name)
        groups = [tests for tests, where in answer["lines"].get(name, ()) if not same or wanted.intersection(where)]
        if groups:
            names, chosen = list(answer["seconds"]), set().union(*groups)
            for i, test in enumerate(names, 1):
                (times if i in chosen else beside)[test] = answer["seconds"][test]
    return times, beside


def main() -> None:
    """Ask the files that are named, or all, as far as they have changed."""
    import_libraries()
    _import_package()
    stale = [file for file in sys.argv[1:] or test_files() if not up_to_date(file)]
    running: dict[int, str] = {}
    with tempfile.TemporaryDirectory(prefix="reached-") as temporary:
        for place in range(len(stale) + CORES):
            if place < len(stale):
                child = os.fork()
                if child == 0:
                    os.environ["TMPDIR"] = tempfile.mkdtemp(dir=temporary)
                    _in_child(stale[place])
                running[child] = stale[place]
            if running and place >= CORES - 1:
                child, status, usage = os.wait4(-1, 0)
                code = os.waitstatus_to_exitcode(status)
                end = f", ended with {code}" if code else ""
                sys.stdout.write(f"{running.pop(child)}: {usage.ru_utime + usage.ru_stime:.0f} s{end}\n")
                sys.stdout.flush()


if __name__ == "__main__":
    main()
