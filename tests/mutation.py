"""Mutation testing: change one operator or number at a time, and count the changes that no test notices.

Python is mutated by the operators of cosmic-ray, C by the exchanges of ``C_EXCHANGES``. A program, not a test:

    python tests/mutation.py kinematics singularities dynamics --python 40 --c 20 --seed 7

Each mutant is judged in a copy of the committed tree, first by the tests that bear its file's name (``compiled`` where
it is C), then by the tests of its room and the mission test, then by all tests of ``make test``. It prints the changed
line of each mutant and what became of it, and at the
end how many survived. Whether a survivor changes any result at all is for the reader to judge.
"""

from __future__ import annotations

import argparse
import difflib
import os
import random
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator

ROOT = Path(__file__).resolve().parents[1]

PYTHON_OPERATORS = [
    *(f"ReplaceBinaryOperator_{pair}" for pair in ("Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "Pow_Mul")),
    *(f"ReplaceComparisonOperator_{pair}" for pair in ("Lt_GtE", "Gt_LtE", "LtE_Gt", "GtE_Lt", "Eq_NotEq", "NotEq_Eq")),
    *("ReplaceUnaryOperator_USub_UAdd", "ReplaceUnaryOperator_Delete_Not", "AddNot"),
    *("ReplaceAndWithOr", "ReplaceOrWithAnd", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue"),
    *("ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "NumberReplacer"),
]
"""Operators of cosmic-ray: a sign, an order, a condition, a number."""

C_EXCHANGES = [
    *((rf" {re.escape(a)} ", f" {b} ") for a, b in ("+-", "-+", "*/", "/*", ("+=", "-="), ("-=", "+="))),
    *((rf" {re.escape(a)} ", f" {b} ") for a, b in (("<", ">="), (">", "<="), ("&&", "||"), ("||", "&&"))),
    (r"(?<=[(=,:?] )-(?=\w)|(?<=[(\[])-(?=\w)|(?<=return )-(?=\w)", ""),
    (r"!(?=[\w(])", ""),
    (r"\b0\.5\b", "0.25"),
    (r"\b2\.0\b", "3.0"),
]
"""Pattern and replacement: a sign, an order, a condition, a factor."""

PATIENCE = 1200.0
"""Seconds after which a mutant counts as noticed: its tests do not end."""

JUDGES = {"kinematics": ("tests/test_loading.py",), "dynamics": ("tests/codegen", "tests/simulation/test_forward.py")}
"""Tests beside ``tests/<room>`` and the mission test that judge a room first."""


class Mutant(NamedTuple):
    """One change: the file, relative to the checkout, and its changed text."""

    path: Path
    text: str

    def __str__(self) -> str:
        """Return the place and the changed line."""
        lines = difflib.unified_diff((ROOT / self.path).read_text().splitlines(), self.text.splitlines(), n=0)
        changed = [line.strip() for line in lines if not line.startswith(("---", "+++"))]
        return f"{self.path}: {'  '.join(changed)}"


def choose_python_mutants(files: Sequence[Path], count: int, dice: random.Random) -> Iterator[Mutant]:
    """Give ``count`` changes of Python files: the file by its length, then the operator, then the place."""
    sizes, seen = [path.stat().st_size for path in files], set[Mutant]()
    while count:
        path = dice.choices(files, sizes)[0]
        operator, source = get_operator(f"core/{dice.choice(PYTHON_OPERATORS)}")(), path.read_text(encoding="utf-8")
        places = sum(len(list(operator.mutation_positions(node))) for node in ast_nodes(get_ast(source)))
        text = mutate_code(source, operator, dice.randrange(places)) if places else None
        if text not in (None, source) and (mutant := Mutant(path.relative_to(ROOT), text)) not in seen:
            seen.add(mutant)
            yield mutant
            count -= 1


def choose_c_mutants(files: Sequence[Path], count: int, dice: random.Random) -> Iterator[Mutant]:
    """Give ``count`` changes of C files, comments left out."""
    sizes, seen = [path.stat().st_size for path in files], set[Mutant]()
    while count:
        path, (pattern, replacement) = dice.choices(files, sizes)[0], dice.choice(C_EXCHANGES)
        source = path.read_text(encoding="utf-8")
        comments = [match.span() for match in re.finditer(r"/\*.*?\*/|//[^\n]*", source, re.DOTALL)]
        places = [match.span() for match in re.finditer(pattern, source)]
        places = [place for place in places if not any(a <= place[0] < b for a, b in comments)]
        if places:
            start, end = dice.choice(places)
            mutant = Mutant(path.relative_to(ROOT), source[:start] + replacement + source[end:])
            if mutant not in seen:
                seen.add(mutant)
                yield mutant
                count -= 1


def failed_test(copy: Path, cache: Path, tests: Sequence[str]) -> str:
    """Run tests in a copy of the tree; return the first that fails, or nothing."""
    environment = os.environ | {"PYTHONPATH": str(copy), "REDUNDANCY_PIN_CACHE": str(cache), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "2", "--no-header", *tests]
    try:
        done = subprocess.run(
            command, cwd=copy, env=environment, capture_output=True, text=True, timeout=PATIENCE, check=False
        )
    except subprocess.TimeoutExpired:
        return "tests that do not end"
    if done.returncode == 0:
        return ""
    failed = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", done.stdout, re.MULTILINE)
    return failed[1] if failed else done.stdout.strip().splitlines()[-1] if done.stdout.strip() else "an error"


def judge(mutant: Mutant, copy: Path, cache: Path) -> str:
    """Return the test that notices a mutant, or nothing; the copy is as it was afterwards."""
    room = mutant.path.parts[1]
    own = [name for name in (f"tests/{room}", "tests/test_mission.py", *JUDGES.get(room, ())) if (copy / name).exists()]
    topic = "compiled" if mutant.path.suffix == ".c" else mutant.path.stem
    named = [str(path.relative_to(copy)) for path in (copy / "tests").rglob(f"test_{topic}*.py")]
    target = copy / mutant.path
    target.write_text(mutant.text, encoding="utf-8")
    try:
        return (
            (named and failed_test(copy, cache, named))
            or failed_test(copy, cache, own)
            or failed_test(copy, cache, ["tests"])
        )
    finally:
        target.write_text((ROOT / mutant.path).read_text(encoding="utf-8"), encoding="utf-8")


def main() -> None:
    """Choose mutants, judge them and print what became of each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rooms", nargs="+", help="folders of redundancy_pin")
    parser.add_argument("--python", type=int, default=40, help="number of mutants of Python files")
    parser.add_argument("--c", type=int, default=20, help="number of mutants of C files")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=1, help="number of the first mutant to judge")
    parser.add_argument("--last", type=int, help="number of the last mutant to judge")
    given = parser.parse_args()
    dice = random.Random(given.seed)
    folders = [ROOT / "redundancy_pin" / room for room in given.rooms]
    python, c = ([path for folder in folders for path in sorted(folder.rglob(kind))] for kind in ("*.py", "*.c"))
    mutants = [*choose_python_mutants(python, given.python, dice), *choose_c_mutants(c, given.c, dice)]
    judged = survivors = 0
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder:
        copy, cache = Path(folder, "copy"), Path(folder, "cache")
        os.chmod(folder, 0o755)  # tests of what another user may do read the copy
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(copy)], check=True)
        cache.mkdir(mode=0o700)
        for number, mutant in [*enumerate(mutants, 1)][given.first - 1 : given.last]:
            by = judge(mutant, copy, cache)
            if "::" in by and failed_test(copy, cache, [by]):
                raise SystemExit(f"{by} fails without a mutant too: mend it, its verdicts do not count")
            judged, survivors = judged + 1, survivors + (not by)
            print(f"{number}: {f'killed by {by}' if by else 'SURVIVED'}: {mutant}", flush=True)
    print(f"{judged - survivors} of {judged} killed")


if __name__ == "__main__":
    main()
