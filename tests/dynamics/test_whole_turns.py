"""Coordinates many turns of a joint away: as within the first turn, and the turns that other joints make on the way."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest
from generated_c import COMPILERS, Code
from written import J, urdf_of, write_robot

import redundancy_pin as rp
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.compiled import CompiledDynamics
from redundancy_pin.errors import UnreachablePoseError
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.robot import Robot
from redundancy_pin.status import SampleStatus

TURN = 2.0 * np.pi
TURNS = (0, 1, -1, 10, 790, -790, 1_000_000)
HERE = 1.3
BACKENDS: dict[str, Callable[[Robot], Dynamics]] = {"rnea": rp.RneaDynamics, "compiled": CompiledDynamics}
STIFFNESS = 0.02
GRAVITY = 9.81


def angle_after(turns: int) -> float:
    return HERE + TURN * turns


def within_a_turn(angle: float) -> float:
    """What is left of an angle as it was rounded: sine and cosine of large numbers are exact."""
    return float(np.arctan2(np.sin(angle), np.cos(angle)))


def motion_at(x: float, xd: float = 0.0, xdd: float = 0.0) -> rp.PlatformMotion:
    return rp.PlatformMotion([0.0], [[x]], [[xd]], [[xdd]])


def near(found: object, expected: object, x: float, scale: float = 1.0) -> None:
    """Equal but for rounding, that of an angle of this size included."""
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=scale * (1e-11 + 4.0 * np.spacing(abs(x))))


@cache
def crank_rocker() -> Robot:
    return rp.with_limits(rp.load_robot("four_bar"), {"crank": {"lower": -1e7, "upper": 1e7}})


@cache
def drag_link() -> Robot:
    """A four-bar whose rocker turns with its crank, against a torsion spring that is wound up."""
    lengths = {"ground_length": 0.1, "crank_length": 0.3, "coupler_length": 0.35, "rocker_length": 0.4}
    return rp.load_robot("four_bar", **lengths).loaded(rp.JointForces("rocker", stiffness=STIFFNESS))


@cache
def geared(*polynomial: float) -> Robot:
    """Two pendulums, the second driven by the first."""
    declaration = {
        "gravity": [0.0, -GRAVITY, 0.0],
        "couplings": [{"joint": "second", "of": "first", "polynomial": list(polynomial)}],
        "actuated": ["first"],
        "independent": {"joints": ["first"]},
        "reference": {"joints": {"first": HERE}, "guess": {"second": float(np.polyval(polynomial[::-1], HERE))}},
    }
    joints = [J("first", "revolute", "base", "arm"), J("second", "revolute", "base", "other", (1.0, 0.0, 0.0))]
    return rp.load_robot(write_robot(Path(mkdtemp()), urdf_of(joints), declaration))


def holding(x: float, *polynomial: float) -> float:
    """Torque that holds the pendulums: the slope of m g (y of both centres at (0.1, 0.02))."""
    second, slope = np.polyval(polynomial[::-1], x), np.polyval(np.polyder(polynomial[::-1]), x)
    lever = [0.1 * np.cos(angle) - 0.02 * np.sin(angle) for angle in (x, second)]
    return float(GRAVITY * (lever[0] + slope * lever[1]))


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("turns", TURNS)
def test_a_crank_is_the_same_after_any_number_of_turns(backend: str, turns: int) -> None:
    dynamics, x = BACKENDS[backend](crank_rocker()), angle_after(turns)
    plain, far = (dynamics.reduce(motion_at(each, 2.0, 3.0)) for each in (within_a_turn(x), x))
    for name in ("f", "W"):
        near(getattr(far, name), getattr(plain, name), x)
    assert rp.distribute(far).status[0] == rp.distribute(plain).status[0]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("turns", [*TURNS[:-1], 5_000])
def test_a_joint_that_turns_along_keeps_its_turns(backend: str, turns: int) -> None:
    """Each turn winds the spring up by 2π; the work of that is STIFFNESS 2π turns dφ."""
    dynamics, x = BACKENDS[backend](drag_link()), angle_after(turns)
    slope = float(inverse_kinematics(drag_link(), motion_at(within_a_turn(x))).gamma[0, 1, 0])
    assert abs(slope) > 0.2
    plain, far = (dynamics.reduce(motion_at(each)).f for each in (within_a_turn(x), x))
    wound = STIFFNESS * TURN * turns * slope
    near(far - plain, wound, x, max(1.0, abs(wound)))


@pytest.mark.parametrize("backend", BACKENDS)
def test_turns_of_a_dependent_joint_are_given_up_where_they_would_open_the_loops(backend: str) -> None:
    dynamics, x = BACKENDS[backend](drag_link()), angle_after(1_000_000)
    plain, far = (dynamics.reduce(motion_at(each)).f for each in (within_a_turn(x), x))
    near(far, plain, x)


WHOLE = (0.2, 1.0, 1.0 / (2.0 * HERE + TURN))
"""The first turn adds one more turn of the second joint, the next ones add others."""
NEVER = [(0.2, 0.1 * 2.0**0.5), (0.2, 1.0, 1e-5)]
"""An incommensurate ratio, and a curved one."""
GEARS = [
    *((backend, (0.2, 2.5), turns) for backend in BACKENDS for turns in TURNS[:-1]),
    *((backend, WHOLE, 4) for backend in BACKENDS),
    *(("compiled", polynomial, 790) for polynomial in NEVER),
    ("compiled", (0.2, 0.1234), 1_000_000),  # a ratio of 617 to 5000; RNEA takes a minute
    pytest.param("rnea", (0.2, 0.1234), 1_000_000, marks=pytest.mark.long),
]


@pytest.mark.parametrize(("backend", "polynomial", "turns"), GEARS)
def test_gears_do_not_come_round_with_every_turn(backend: str, polynomial: tuple[float, ...], turns: int) -> None:
    x = angle_after(turns)
    found = BACKENDS[backend](geared(*polynomial)).reduce(motion_at(x)).f[0, 0]
    near(found, holding(x, *polynomial), x, 100.0 if polynomial == WHOLE else 10.0)


@pytest.mark.parametrize("polynomial", NEVER)
def test_turns_that_never_repeat_are_followed_one_by_one_up_to_a_number(polynomial: tuple[float, ...]) -> None:
    with pytest.raises(UnreachablePoseError, match=r"1000000 turns of 'first' away, which do not repeat"):
        CompiledDynamics(geared(*polynomial)).reduce(motion_at(angle_after(1_000_000)))


@pytest.mark.parametrize("backend", BACKENDS)
def test_samples_too_many_turns_away_are_marked_and_others_are_not(backend: str) -> None:
    robot, x, still = geared(0.2, 0.1 * 2.0**0.5), angle_after(20_000), np.zeros((3, 1))
    dynamics = BACKENDS[backend](robot)
    motion = rp.PlatformMotion([0.0, 1.0, 2.0], [[0.3], [x], [0.4]], still, still, check_rates=False)
    reduced = dynamics.along(motion, unreachable="mark").reduce()
    assert reduced.reachable.tolist() == [True, False, True]
    near(reduced.f[[0, 2], 0], [holding(one, 0.2, 0.1 * 2.0**0.5) for one in (0.3, 0.4)], 1.0, 10.0)
    assert not dynamics.along(motion[1:2], unreachable="mark").reduce().reachable.any()
    with pytest.raises(UnreachablePoseError, match="which do not repeat") as caught:
        dynamics.reduce(motion)
    assert caught.value.details["sample"] == 1
    assert dynamics.torque([x], [0.0], [0.0]).status is SampleStatus.UNREACHABLE
    assert not rp.forward_kinematics(robot, [[x]]).known.any()


def test_one_sample_after_another_and_a_motion_agree() -> None:
    """A motion counts the turns of a dependent joint as it goes; a sample far away has as many."""
    t = np.linspace(0.0, 1.0, 200)
    x = HERE + 3.2 * TURN * t
    full, ones = np.ones((200, 1)), CompiledDynamics(drag_link())
    motion = rp.PlatformMotion(t, x[:, None], 3.2 * TURN * full, 0.0 * full)
    f = ones.reduce(motion).f
    near([ones.sample([x[k]], [3.2 * TURN], [0.0]).f for k in (199, 7, 120)], f[[199, 7, 120]], x[-1], 100.0)


@pytest.mark.skipif(not COMPILERS, reason="no compiler is installed")
@pytest.mark.parametrize("turns", TURNS)
def test_generated_c_goes_there(turns: int) -> None:
    x = angle_after(turns)
    for robot in (crank_rocker(), geared(0.2, 2.5)):
        if robot is not crank_rocker() and turns == TURNS[-1]:
            continue  # the geared joint is rounded to 1e-9 there
        code = Code(robot)
        state = code.start()
        assert code.go_to(state, np.array([x])) == 0
        got = code.efforts(state, np.array([x]), np.array([2.0]), np.array([3.0]))
        expected = rp.RneaDynamics(robot).reduce(motion_at(x, 2.0, 3.0))
        assert got.status == 0
        near(got.f, expected.f[0], x, 10.0)
        assert code.go_to(state, np.array([HERE])) == 0
