"""Dual numbers: through expressions against differences, through text and a whole file, and where they are lost."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from redundancy_pin import load_robot
from redundancy_pin.dynamics.compiled import design
from redundancy_pin.errors import ModelFileError
from redundancy_pin.robot.formats.duals import Dual, LostDerivativeError, derivatives_kept, read
from redundancy_pin.robot.formats.expressions import BUILTINS, MATHEMATICS, Budget, evaluate
from redundancy_pin.robot.urdf import models_root

AT = {"a": 0.7, "b": -1.3}
STEP = 1e-5
NAMES = {**BUILTINS, **MATHEMATICS}


def value(expression: str, **numbers: float) -> float:
    return float(evaluate(expression, {**NAMES, **numbers}, Budget()))


@pytest.mark.parametrize(
    "expression",
    [
        "a * b + a / b - b**3",
        "2 - a + 3 / b + (1 + b) * 2",
        "2**a + a**b + pow(a, 2.5) + (-b)**0.5",
        "sin(a) * cos(b) + tan(a * b)",
        "sqrt(a) * exp(b) + log(a) + asin(a) - acosh(2 + a)",
        "atan2(a, b) + hypot(a, b) + radians(a) * degrees(b) + fabs(b)",
        "-a if a > 0 else a",
        "max(a, b) - min(a, 2) + abs(b) + abs(a)",
        "sum([a, b, 1]) + [x * a for x in range(3)][2] + sorted([a, b])[0]",
        "float(str(a)) * 2 + +a",
    ],
)
def test_expressions(expression: str) -> None:
    units = np.eye(2)
    with derivatives_kept():
        got = evaluate(expression, {**NAMES, **{name: Dual(AT[name], units[i]) for i, name in enumerate(AT)}}, Budget())
    assert float(got) == value(expression, **AT)
    for i, name in enumerate(AT):
        up, down = (value(expression, **{**AT, name: AT[name] + by}) for by in (STEP, -STEP))
        assert got.dot[i] == pytest.approx((up - down) / (2 * STEP), rel=1e-8, abs=1e-9)


@pytest.mark.parametrize("number", [1.0, -0.1, 1 / 3, -2.5e-17, 6.02e23, 0.0, math.pi, 5e-324])
def test_text_brings_number_and_derivatives_back(number: float) -> None:
    dot = np.array([2.0, -3.0])
    with derivatives_kept():
        text = str(Dual(number, dot))
        back, negated = read(text), read("-" + text) if number > 0 else None
        assert isinstance(back, Dual)
        assert float(back) == number == (float(text) if number else 0.0)
        np.testing.assert_array_equal(back.dot, dot)
        if negated is not None:
            assert float(negated) == -number
            np.testing.assert_array_equal(negated.dot, -dot)
        # a literal among others
        got = evaluate(f"2 * {text} if True else 0.0", NAMES, Budget())
        np.testing.assert_array_equal(got.dot, 2 * dot)
        if number:
            with pytest.raises(LostDerivativeError):
                read(text[:-1] + str((int(text[-1]) + 1) % 10))
            for more in (f"0{text}", f"1{text}") if number > 0 else ():  # a model that puts digits before it
                with pytest.raises(LostDerivativeError):
                    read(more)
    assert not isinstance(read(text), Dual)


@pytest.mark.parametrize(
    "expression",
    ["round(a, 3)", "int(a)", "a // b", "a % b", "'%.2f' % a", "'{:.2f}'.format(a)", "floor(a)", "gamma(a)"],
)
def test_what_has_no_derivative_is_not_taken_for_a_constant(expression: str) -> None:
    with derivatives_kept(), pytest.raises(LostDerivativeError):
        evaluate(expression, {**NAMES, "a": Dual(0.7, np.ones(1)), "b": 2.0}, Budget())


def changed(folder: Path, old: str, new: str) -> Path:
    """A 3-RRR with another line in its xacro file."""
    shutil.copytree(models_root() / "3rrr", folder / "own")
    file = folder / "own" / "3rrr.urdf.xacro"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    return folder / "own"


ELBOW, CENTRE = '<origin xyz="${proximal_length} 0 0"', '<origin xyz="${start + length / 2} 0 0"'


@pytest.mark.parametrize(
    ("numbers", "old", "new"),
    [
        # put together as text
        (("tail_length",), 'start="${-tail_length}"', 'start="-${tail_length}"'),
        pytest.param(("proximal_length",), f"{ELBOW}/>", ELBOW + ' rpy="0 0 ${0.1 * proximal_length}"/>',
                     marks=pytest.mark.long),
        (("distal_mass",), f"{CENTRE}/>\n        <mass",
         CENTRE + ' rpy="${0.2 * mass} 0.1 ${length}"/>\n        <mass'),
    ],
)  # fmt: skip
def test_a_whole_file_against_differences(tmp_path: Path, numbers: tuple[str, ...], old: str, new: str) -> None:
    robot = load_robot(changed(tmp_path, old, new))
    exact = design.by_duals(robot, numbers)
    for name in numbers:
        for got, want in zip(exact[name], design.by_xacro(robot, name, False), strict=True):
            assert set(want) <= set(got)
            for key, column in got.items():
                np.testing.assert_allclose(column, want.get(key, 0.0 * column), atol=1e-11, err_msg=f"{name} {key}")


def test_a_file_that_rounds_is_differenced(tmp_path: Path) -> None:
    robot = load_robot(changed(tmp_path, 'iyy="${mass * length**2 / 12}"', 'iyy="${round(mass * length**2 / 12, 15)}"'))
    with pytest.raises(ModelFileError, match="derivative of round"):
        design.by_duals(robot, ("distal_mass",))
    got = design.design_of(robot, ["distal_mass"])
    want = design.design_of(load_robot("3rrr"), ["distal_mass"])
    for key, column in want.inertias.items():
        np.testing.assert_allclose(got.inertias[key], column, atol=1e-9)
