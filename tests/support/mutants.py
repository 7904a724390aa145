"""Mutants: a sign, a comparison or a factor changed at a random place of a copy of the package; do its tests notice?

As a program it prints each mutant and what became of it: ``python tests/support/mutants.py [count] [first]``.
"""

from __future__ import annotations

import ast
import compileall
import functools
import importlib.util
import os
import random
import resource
import shutil
import signal
import stat
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

import pytest
from reached import KEPT, PACKAGE, QUIET, ROOT, import_libraries, tests_reaching

ROOMS = ("dynamics", "kinematics", "trajectory", "robot", "planners")
"""Where mutants are made."""

KILLED = "killed by "

INTERFACES = "tests/test_front_doors.py"
"""Imports everything: the quickest test of what runs at import time."""

STAGES = (8.0, 60.0, 900.0)
"""s of the processor that the tests take up to the end of a stage, without a mutant: quick ones and near ones first.

A mutant that all of these do not notice is undecided if there are more tests that reach it, and counts as a survivor.
"""

PATIENCE = 8.0, 60.0
"""A stage that takes so many times as long as without a mutant, and so many s more, does not end: that is noticed."""

ASLEEP = 7200
"""The same in s on the clock, for one that waits: however busy the machine is."""

NOT_COPIED = (
    ".git",
    ".venv",
    "build",
    "dist",
    "results",
    "study",
    ".pytest_cache",
    ".mypy_cache",
    ".ruff_cache",
    ".hypothesis",
)
"""Of the checkout: what is made in it."""

NOBODY = 65534
"""User and group of mutants that root starts: one of root's own has replaced ``/dev/null`` by a file."""

FACTORS = (1e-2, 1e2)
"""Constants between these are changed; smaller ones are tolerances, larger ones bounds that hardly anything meets."""

EQUIVALENT: dict[tuple[str, str, str], str] = {
    ("dynamics/distribution.py", "return read_only(cost / cost.max())", "/"): "weights count relative to each other",
    (
        "planners/switch_off/carrier_equation.py",
        "elif after < narrow:",
        "<",
    ): "the stretch on the other side does as well",
    (
        "trajectory/waypoints.py",
        "u = np.where((newton >= low) & (newton <= high), newton, 0.5 * (low + high))",
        "0.5*+",
    ): "a safeguard: in panels so short Newton's steps leave their bracket by rounding only (395 random splines tried)",
    (
        "kinematics/tree.py",
        "if b.size < _FEW:  # the number of calls counts, and not that of products",
        "<",
    ): "which of two ways to the same products, of which each is tried",
    (
        "kinematics/chain.py",
        "if not (math.sin(new_side) * math.sin(old_side) if turns else new_side * old_side) > 0.0:",
        "*",
    ): "the sign of a product is that of a quotient",
    (
        "kinematics/tree.py",
        "kinds = _grouped(ends, lambda e: (place[e[1]][0] if e[1] else -1, e[4], bool((e[2] == np.eye(3)).all())))",
        "==",
    ): "which frames are placed by one product",
    (
        "kinematics/continuation.py",
        "lost = np.flatnonzero((sign[0] * sign[1] <= 0.0) | (size.min(axis=0) <= ROUNDING))",
        "*",
    ): "signs are one or minus one; of zero the size is zero too",
    (
        "planners/carrier_model.py",
        "units = (np.array(0), np.array(1), 2 + terms, np.array(2 + TERMS), 3 + TERMS + terms)",
        "+",
    ): "which coefficients share a tolerance of 1e-12",
    (
        "kinematics/assembly.py",
        "if 2 * done.sum() > len(done):  # go on with the rest alone; to leave out fewer costs more than it saves",
        ">",
    ): "when samples that are done are left out: each ends where it would end alone",
    (
        "planners/switch_off/carrier_equation.py",
        "after = min(float(kinks[kinks > t].min()) - t, 0.5 * width)",
        "*",
    ): "a stretch that is too long is halved until its series ends",
    (
        "planners/whole_trajectory/multistart.py",
        "phase = frequency * (grid.t[:, None] - grid.t[0])",
        "-",
    ): "random swings to begin with: at another phase they are as random",
    (
        "dynamics/compiled/design.py",
        "return _without_rounding(placements, 1.0 / step), _without_rounding(inertias, 1.0 / step)",
        "1.0/",
    ): "another size of what counts as rounding",
    (
        "planners/whole_trajectory/multistart.py",
        'percent = f"{100.0 * fraction:.3g}" if fraction < 1.0 else f"{100.0 * fraction:.0f}"',
        "1.0",
    ): "up to 200 % both ways of writing it say the same",
    (
        "planners/switch_off/crossing.py",
        "size = float(max(np.abs(here.f0 / row_scale).max(), np.abs(load / row_scale).max(), 1e-12))",
        "/",
    ): "the size of a tolerance: off by the square of a length of about a metre",
    (
        "planners/receding_horizon/programme.py",
        "np.where(np.isfinite(width), 0.5 * width, 1.0),",
        "0.5*",
    ): "the unit of an unknown, which the programme is solved in",
    (
        "planners/time_optimal/planner.py",
        "acceleration = 2.0 * speed**2 / length",
        "2.0*/",
    ): "the unit of an unknown, which the programme is solved in",
    (
        "kinematics/tree.py",
        "rotation, translation = np.stack([e[1] for e in elements]), np.stack([e[2] for e in elements], axis=-1)",
        "-",
    ): "of stacked vectors the second axis is the last one",
    (
        "kinematics/continuation.py",
        "start, done, size = here.x, 0.0, 0.5",
        "0.5",
    ): "the whole step, which has failed already, fails once more, and its half follows",
    (
        "kinematics/chain.py",
        "if places != (96 * i, 96 * i + 72) or rotation.strides != (8, 24) or translation.strides != (8,):",
        "!= +",
    ): "what need not be copied is copied",
    (
        "kinematics/inverse_kinematics.py",
        "if (side[first] * mode < 0.0).any() and first > 0 and regular[first - 1 : first + 1].all():",
        "*",
    ): "sides and modes are signs",
    (
        "planners/stepwise/optimiser.py",
        "if most > 0.0 and (step + 0.5 * most / a) * most > ahead:",
        "0.5",
    ): "asks for the stoppable speed where it is the larger one: the least of both is the same",
    (
        "planners/stepwise/optimiser.py",
        "if least < 0.0 and (step - 0.5 * least / a) * -least > behind:",
        "0.5",
    ): "as the line before it",
    (
        "planners/receding_horizon/ahead.py",
        "inside = (zeros.real >= start - 1e-9 * width) & (zeros.real <= end + 1e-9 * width)",
        "*",
    ): "a slack for rounding: what is beyond the ends is found from the next piece, and once",
    (
        "planners/receding_horizon/planner.py",
        "if self.robot.m == n:",
        "==",
    ): "of a square W that is regular the pseudoinverse is the inverse",
    (
        "dynamics/inverse_dynamics.py",
        "return bool((margin[1:] * margin[:-1] <= 0.0).any() or (size - 2.0 * fall <= 0.0).any() or stays.any())",
        "<=",
    ): "singularities are looked for where there are none",
    (
        "kinematics/continuation.py",
        "others = _NODES[None, :] - _NODES[:, None] + np.eye(count)",
        "+",
    ): "all weights change their sign, and count relative to each other",
    (
        "kinematics/coordinates.py",
        "result: BoolArray = (mode_indicator(robot, q) * wanted > 0.0).all(axis=1)",
        "*",
    ): "what is wanted are signs",
    (
        "kinematics/multistart.py",
        "away[:, turning] = (away[:, turning] + np.pi) % (2.0 * np.pi) - np.pi",
        "+",
    ): "a whole turn, which the remainder takes away",
    (
        "robot/formats/duals.py",
        'negated = text.strip().startswith("-") != (math.copysign(1.0, value) < 0.0)',
        "1.0",
    ): "asks for a sign",
    (
        "kinematics/coordinates.py",
        "delta[..., turns] = (delta[..., turns] + np.pi) % (2.0 * np.pi) - np.pi",
        "+",
    ): "a whole turn, which the remainder takes away",
}
"""Path, line and operators of changes that change no result, and why: they are not drawn."""

SWAPPED: dict[type[ast.AST], tuple[str, str]] = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.Lt: ("<", ">"),
    ast.Gt: (">", "<"),
    ast.LtE: ("<=", ">="),
    ast.GtE: (">=", "<="),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
}


@dataclass(frozen=True)
class Mutant:
    """A change of a file of the package, from ``start`` to ``end`` in bytes."""

    path: str
    line: int
    start: int
    end: int
    old: str
    new: str

    @property
    def text(self) -> str:
        """The line that it changes."""
        return (PACKAGE / self.path).read_text(encoding="utf-8").splitlines()[self.line - 1].strip()

    def __str__(self) -> str:
        """Return where it is and what it changes."""
        return f"{self.path}:{self.line}: {self.old} becomes {self.new} in: {self.text}"

    @functools.cached_property
    def reach(self) -> tuple[range, bool]:
        """Lines of which a test that notices it executes one, and whether it is executed as the module is imported.

        They are those of its statement; of a default those of its function, of what is in no function all of the file.
        """
        data = (PACKAGE / self.path).read_bytes()
        around = [ast.parse(data)]
        while inner := [node for node in _statements(around[-1]) if node.lineno <= self.line <= (node.end_lineno or 0)]:
            around.append(inner[-1])
        functions = [node for node in around if isinstance(node, ast.FunctionDef)]
        last, whole = around[-1], range(1, data.count(b"\n") + 2)
        if not functions:
            return whole, True
        body = getattr(last, "body", [])
        if last is functions[-1]:
            return range(body[0].lineno, (last.end_lineno or 0) + 1), True
        return range(last.lineno, body[0].lineno if body else (last.end_lineno or 0) + 1), False


def _changeable(node: ast.AST) -> Iterator[ast.AST]:
    """Give the nodes below one whose change a run could notice: no annotations, messages, texts, defaults of types."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, (ast.Raise, ast.Assert, ast.JoinedStr)):
            continue
        if isinstance(child, ast.FunctionDef) and child.name == "__repr__":
            continue
        if isinstance(child, ast.AnnAssign):
            if child.value is not None and not isinstance(node, ast.Module):
                yield child.value
                yield from _changeable(child.value)
            continue
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test):
            continue
        # named constants of a module are choices (steps tried, safeguards, tolerances), not formulas
        if isinstance(node, ast.Module) and isinstance(child, ast.Assign):
            continue
        if isinstance(child, ast.arg) or child is getattr(node, "returns", None):
            continue
        # numbers of a subscript are places, not factors
        if isinstance(child, ast.Subscript):
            yield child.value
            yield from _changeable(child.value)
            continue
        yield child
        yield from _changeable(child)


def _statements(node: ast.AST) -> Iterator[Any]:
    """Give the statements right below one, those of its branches and handlers included."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.stmt):
            yield child
        elif isinstance(child, (ast.ExceptHandler, ast.match_case)):
            yield from _statements(child)


@functools.cache
def mutants() -> tuple[Mutant, ...]:
    """Return every mutant of the rooms, in order."""
    paths = {path for room in ROOMS for path in (PACKAGE / room).rglob("*.py")}
    return tuple(mutant for path in sorted(paths) for mutant in _of_file(path))


def _of_file(path: Path) -> Iterator[Mutant]:
    data, name = path.read_bytes(), path.relative_to(PACKAGE).as_posix()
    starts = [0]
    for line in data.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))

    def ends(node: Any) -> tuple[int, int]:
        return starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset

    for node in _changeable(ast.parse(data)):
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            start, _ = ends(node)
            yield Mutant(name, node.lineno, start, start + 1, "-", " ")
        elif isinstance(node, ast.Constant) and isinstance(node.value, float):
            if FACTORS[0] <= node.value <= FACTORS[1]:
                start, end = ends(node)
                yield Mutant(name, node.lineno, start, end, data[start:end].decode(), repr(2.0 * node.value))
        else:
            left, kind, right = _operation(node)
            old, new = SWAPPED.get(type(kind), ("", ""))
            # between the operands there are an operator, blanks and parentheses
            where = data.find(old.encode(), ends(left)[1], ends(right)[0]) if old else -1
            if where >= 0:
                yield Mutant(name, data[:where].count(b"\n") + 1, where, where + len(old), old, new)


def _operation(node: ast.AST) -> tuple[Any, Any, Any]:
    """Return left operand, operator and right operand of numbers; the operator is None where there are none."""
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        return node.left, node.ops[0], node.comparators[0]
    if isinstance(node, ast.BinOp):
        texts = isinstance(node.left, ast.Constant) and not isinstance(node.left.value, (int, float))
        if not texts and not isinstance(node.left, (ast.List, ast.Tuple)):
            return node.left, node.op, node.right
    return None, None, None


def chosen(number: int) -> Mutant:
    """Return a random mutant: each room as often as it has places, the same for the same number."""
    dice = random.Random(f"mutant/{number}")
    while True:
        mutant = dice.choice(mutants())
        alike = (operators for path, text, operators in EQUIVALENT if (path, text) == (mutant.path, mutant.text))
        if not any(mutant.old in operators for operators in alike):
            return mutant


def tests_of(mutant: Mutant) -> tuple[list[dict[str, float]], int]:
    """Return the tests that reach a mutant in stages, with the time that each takes without it; and how many are left.

    First quick ones, files named like it, and its room. The last are the other tests of files that reach it: they may
    use what a first test has computed and kept.
    """
    lines, importing = mutant.reach
    reaching, beside = tests_reaching(mutant.path, lines)
    stem, room = Path(mutant.path).stem.rstrip("s"), mutant.path.partition("/")[0]

    def cost(test: str) -> float:
        near = 4.0 * (stem in test) + 2.0 * test.startswith(f"tests/{room}") + (mutant.path.rpartition("/")[0] in test)
        return (reaching[test] + 0.02) / (1.0 + near)

    stages: list[dict[str, float]] = [{} for _ in STAGES]
    if importing:
        stages[0][INTERFACES] = 1.0
    taken, left = 0.0, 0
    for test in (*sorted(reaching, key=cost), *sorted(beside, key=beside.__getitem__)):
        seconds = reaching.get(test, beside.get(test, 0.0))
        taken += seconds
        # a test longer than a stage waits for the last one
        place = next((i for i, most in enumerate(STAGES) if max(taken, 4.0 * seconds) <= most), None)
        if place is None:
            left += 1
        else:
            stages[place][test] = seconds
    return [stage for stage in stages if stage], left


def _is_nobodys() -> bool:
    """Return whether mutants run as nobody: root starts them, and the interpreter is where others may read it."""
    places = (*Path(sys.prefix).resolve().parents, *Path(sys.base_prefix).resolve().parents)
    return os.geteuid() == 0 and all(place.stat().st_mode & stat.S_IXOTH for place in places)


def tree(folder: Path) -> Path:
    """Copy what tests of the rooms need, so that one copy serves several mutants in turn."""
    # all that git has: some tests read how the project is made
    for source in (each for each in sorted(ROOT.iterdir()) if each.name not in NOT_COPIED):
        name = source.name
        if source.is_dir():
            shutil.copytree(source, folder / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
        elif source.exists():
            shutil.copy(source, folder / name)
    for name in ("home", "temporary"):
        (folder / name).mkdir()
    compileall.compile_dir(folder / "redundancy_pin", quiet=2)
    if _is_nobodys():
        for path in (folder, *folder.rglob("*")):
            os.chown(path, NOBODY, NOBODY, follow_symlinks=False)
    return folder


def noticed(mutant: Mutant, folder: Path) -> str:
    """Return which test notices a mutant in a copy of the tree, as "killed by ..."; or "UNDECIDED", or "SURVIVED"."""
    stages, left = tests_of(mutant)
    path = folder / "redundancy_pin" / mutant.path
    right = path.read_bytes()
    if right[mutant.start : mutant.end].decode() != mutant.old:
        raise ValueError(f"{mutant.path} of the copy is another file")
    path.write_bytes(right[: mutant.start] + mutant.new.encode() + right[mutant.end :])
    try:
        for tests in stages:
            by = _failing(tests, folder)
            if by:
                return KILLED + by
    finally:
        path.write_bytes(right)
        Path(importlib.util.cache_from_source(str(path))).unlink(missing_ok=True)
        if not Path(os.devnull).is_char_device():
            raise RuntimeError(f"{mutant} has replaced {os.devnull}: make the device again (mknod -m 666 ... c 1 3)")
    return f"UNDECIDED, {left} tests left" if left else "SURVIVED"


class _First:
    """Runs some tests in their order, and notes down the first that fails, or the file that cannot be collected."""

    def __init__(self, answer: int, tests: Iterable[str]) -> None:
        self.answer, self.place = answer, {test: place for place, test in enumerate(tests)}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        def place(item: pytest.Item) -> int:
            return self.place.get(item.nodeid, self.place.get(item.nodeid.partition("::")[0], -1))

        items[:] = sorted((item for item in items if place(item) >= 0), key=place)

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed:
            os.write(self.answer, report.nodeid.encode() + b"\n")

    def pytest_collectreport(self, report: Any) -> None:
        if report.failed:
            os.write(self.answer, b"import of " + report.nodeid.encode() + b"\n")


def _failing(tests: Mapping[str, float], folder: Path) -> str:
    """Run tests in a forked process until one fails, and return its name."""
    patience = round(PATIENCE[0] * sum(tests.values()) + PATIENCE[1])
    with tempfile.TemporaryFile() as answer:
        child = os.fork()
        if child == 0:
            _in_child(tests, folder, answer.fileno(), patience)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        answer.seek(0)
        first = answer.read().decode().partition("\n")[0]
    if code in (-signal.SIGALRM, -signal.SIGXCPU):
        return f"no end after {patience} s of the processor or {ASLEEP} s"
    if code not in (0, 1, 2, 5) or (code in (1, 2) and not first):  # 5: nothing to run; a crash counts as noticed
        if code >= 0:
            raise RuntimeError(f"pytest ended with {code} on {list(tests)}: {first or 'no test failed'}")
        return f"crash by signal {-code}"
    return first


def _in_child(tests: Mapping[str, float], folder: Path, answer: int, patience: int) -> NoReturn:
    code: int = 99
    try:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(ASLEEP)
        resource.setrlimit(resource.RLIMIT_CPU, (patience, resource.RLIM_INFINITY))
        os.chdir(folder)
        if _is_nobodys():
            os.setgroups([])
            os.setgid(NOBODY)
            os.setuid(NOBODY)
        # nothing of the run that this one is part of: its workers, options and multiples of examples
        for key in [key for key in os.environ if key.startswith(("PYTEST", "EXAMPLES", "SHARE", "PYTHONPATH"))]:
            del os.environ[key]
        os.environ.update(PYTHONPATH=str(folder), HOME=str(folder / "home"), TMPDIR=str(folder / "temporary"))
        tempfile.tempdir = None
        ours = {"", str(ROOT), str(ROOT / "tests" / "support"), str(ROOT / "benchmarks")}
        sys.path[:] = [str(folder), *(entry for entry in sys.path if entry not in ours)]
        sys.dont_write_bytecode = False  # the next mutant need not compile all the tests again
        null = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(null, stream)
        files = dict.fromkeys(test.partition("::")[0] for test in tests)
        code = int(pytest.main(["-x", *QUIET, *files], plugins=[_First(answer, tests)]))
    except BaseException as error:
        os.write(answer, f"{type(error).__name__}: {error}\n".encode())
    finally:
        os._exit(code)


def main() -> None:
    """Make and judge as many mutants as the first argument says, from the number that is the second.

    ``none`` in place of a number changes nothing: a place with quick tests is judged as it is.
    """
    count, first = (*sys.argv[1:], *("10", "0")[len(sys.argv) - 1 :])
    if not any(KEPT.glob("*.json")):
        raise SystemExit("Which tests reach which lines is not known: run tests/support/reached.py first.")
    import_libraries()
    if first == "none":
        quick = next(mutant for mutant in mutants() if mutant.path == "trajectory/csv_file.py")
        drawn = [(first, replace(quick, new=quick.old))] * int(count)
    else:
        drawn = [(str(number), chosen(number)) for number in range(int(first), int(first) + int(count))]
    killers = []
    with tempfile.TemporaryDirectory(prefix="mutants-") as name:
        folder = tree(Path(name))
        for number, mutant in drawn:
            end = noticed(mutant, folder)
            killers += [end.removeprefix(KILLED)] * end.startswith(KILLED)
            sys.stdout.write(f"{number}: {end}: {mutant}\n")
            sys.stdout.flush()
        # a test that fails anyway in such a copy has seen nothing
        named = {name: 60.0 for name in killers if "::" in name}
        anyway = _failing(named, folder) if named else ""
    if anyway and first != "none":
        raise SystemExit(f"{anyway} fails without a mutant too.")
    sys.stdout.write(f"{len(killers)} of {len(drawn)} killed\n")


if __name__ == "__main__":
    main()
