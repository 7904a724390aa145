"""How often the stand-in for machine code evaluates rows: a worse guess or step is still right in the end.

As in ``tests/kinematics/test_work.py`` a count may be 5 % more than was written down: the last step is rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.arrays import CLOSURE_TOLERANCE
from redundancy_pin.dynamics.compiled.closing import Loops, lifted
from redundancy_pin.dynamics.compiled.interpreted import Interpreter
from redundancy_pin.kinematics.coordinates import coordinates, difference
from redundancy_pin.robot import Robot

MORE = 1.05


@pytest.fixture
def rows(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], Any]], int]:
    """Run something, and return how often rows are evaluated."""

    def count(action: Callable[[], Any]) -> int:
        calls, original = [], Interpreter.rows_at
        with monkeypatch.context() as patch:
            patch.setattr(Interpreter, "rows_at", lambda self, q, x: calls.append(1) or original(self, q, x))
            action()
        return len(calls)

    return count


LIFTED = {"2rpr": (207, 32), "3rrr": (279, 34), "five_bar": (208, 33), "four_bar": (242, 34), "gough": (298, 34)}
"""For a hundred samples in a second, and for seven in two."""


def test_samples_take_a_few_newton_steps(shipped: Robot, rows: Callable[[Callable[[], Any]], int]) -> None:
    dynamics, motion = rp.CompiledDynamics(shipped, interpret=True), zoo.smooth_motion(shipped, 1)
    for t, most in zip((np.linspace(0.0, 1.0, 100), np.linspace(0.0, 2.0, 7)), LIFTED[shipped.name], strict=True):
        assert 0.7 * most <= rows(lambda t=t: dynamics.along(motion.at(t))) <= MORE * most


ASSEMBLED = {"2rpr": 115, "3rrr": 102, "five_bar": 102, "four_bar": 101, "gough": 125}


def test_bad_guesses_are_closed_in_some_dozen_steps(shipped: Robot, rows: Callable[[Callable[[], Any]], int]) -> None:
    """By Levenberg and Marquardt's method, ten of them; what is said to be left is left."""
    interpreter = rp.CompiledDynamics(shipped, interpret=True).kernel
    assert isinstance(interpreter, Interpreter)
    rng, home, system = np.random.default_rng(6), zoo.home_of(shipped), zoo.system_of(shipped)

    def run() -> None:
        for _ in range(10):
            step = rng.uniform(-1.0, 1.0, shipped.model.nv)
            step[shipped.carrier_velocity] = 0.0
            q = pin.integrate(shipped.model, np.array(shipped.q_reference), step)
            left = interpreter.assemble(q, np.ravel(home))
            state = system.evaluate(q[None])
            missing = difference(shipped, home[None], coordinates(shipped, state))[0]
            assert left == pytest.approx(np.abs([*state.phi[0], *missing]).max(), abs=1e-12)
            assert left < CLOSURE_TOLERANCE

    assert 0.7 * ASSEMBLED[shipped.name] <= rows(run) <= MORE * ASSEMBLED[shipped.name]


def test_margins_are_those_of_the_tree(shipped: Robot) -> None:
    """In the units of lengths, whatever turns: the distance from a type I singularity that the other backend bounds."""
    motion = zoo.smooth_motion(shipped, 1).at(np.linspace(0.0, 1.0, 9))
    kernel = rp.CompiledDynamics(shipped, interpret=True).kernel
    here, there = lifted(Loops(shipped, kernel, 1), motion, mark=False), rp.RneaDynamics(shipped).along(motion).tree
    np.testing.assert_allclose(here.margin, there.serial_margin_bound, rtol=1e-8)
    assert max(here.gap.max(), there.gap.max()) < CLOSURE_TOLERANCE
