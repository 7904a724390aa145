"""Shared fixtures: the shipped robots, one a test."""

from __future__ import annotations

import gc
import os
import shlex
import sys
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import promises
import pytest
import zoo
from examples import FACTOR
from hypothesis import settings

from redundancy_pin.machine_code import CACHE, NATIVE, find_compiler
from redundancy_pin.robot import Robot

# the same examples every time, so that a change is judged and not the draw; `HYPOTHESIS_PROFILE=explore` looks further
settings.register_profile("fixed", derandomize=True, deadline=None, max_examples=40 * FACTOR)
settings.register_profile("explore", deadline=None, max_examples=1000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "fixed"))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Let the garbage collector leave the tests alone, now and later: they stay to the end."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture(params=zoo.SHIPPED)
def shipped(request: pytest.FixtureRequest) -> Robot:
    """Each shipped robot in turn, loaded once a session."""
    return zoo.robot_of(request.param)


@pytest.fixture(scope="module", autouse=True)
def shared_robots_stay() -> Iterator[None]:
    """No test writes to the model of a robot that others share."""
    yield
    assert zoo.changed() == []


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what ``make long`` runs: property tests, with more examples, and cases that ``long_for`` names.

    With ``RESUME`` in the environment, what an earlier run has counted is left out.
    """
    unknown: dict[str, set[str]] = {}
    for item in items:
        if getattr(getattr(item, "obj", None), "is_hypothesis_test", False):
            item.add_marker(pytest.mark.property)
        chosen = item.get_closest_marker("long_for")
        if chosen and hasattr(item, "callspec"):
            left = unknown.setdefault(item.nodeid.partition("[")[0], set(chosen.args))
            if item.callspec.id in chosen.args:
                left.remove(item.callspec.id)
                item.add_marker(pytest.mark.long)
    misnamed = {name: left for name, left in unknown.items() if left}
    # a single case named on the command line leaves no others to find
    config = items[0].config
    if misnamed and not config.getoption("lf") and not any("::" in argument for argument in config.args):
        raise pytest.UsageError(f"long_for names cases that are not there: {misnamed}")
    if os.environ.get("RESUME"):
        items[:] = [item for item in items if not promises.done(item)]


keep = promises.keep


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Note down what a test counted: in the process that prints, which all reports come to."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        promises.note_down(report)


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Print how often each promise was tried, where a run tried any."""
    promises.summarise(terminalreporter)


COMPILE = f'case " $* " in *" {NATIVE} "*) exec "$0" "$@" ${{LEVEL:--Og}};; *) exec "$0" "$@" ${{LEVEL:--O0}};; esac'
"""A shell's words in place of the compiler, whose command is ``$0``."""


@pytest.fixture(scope="session", autouse=True)
def compiled_libraries(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A cache of compiled robots of this run's own, shared by its workers: nobody's home is written to or read.

    Their compiler optimises nothing, which takes a third of the time and rounds as ever: its last option counts. The
    on-line planner, the one that is compiled for this machine alone, works longer than it is compiled: a little there.
    ``LEVEL`` in the environment is another option.
    """
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "compiled"
    folder.mkdir(exist_ok=True, mode=0o700)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(CACHE, str(folder))
        if compiler := find_compiler():
            patch.setenv("CC", shlex.join(["sh", "-c", COMPILE, *compiler.command]))
        yield folder


@pytest.fixture
def no_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    """A system without a C compiler, that of pip included."""
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setitem(sys.modules, "ziglang", None)
