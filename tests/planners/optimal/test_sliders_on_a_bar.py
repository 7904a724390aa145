"""Carriers along a turning bar, whose equations are three lines: other terms in f, mirrored optima, loads by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import symbolic_mechanisms
import symbolic_plans
import yaml

import redundancy_pin as rp
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.planners.optimal.settings import End
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory import Line, RestToRest, Trajectory

INERTIA, MASS, REACH = 0.01, 0.5, 0.2
"""Of the bar and each slider about its own centre, kg·m²; of a slider, kg; of its place along the bar at s = 0, m."""

LIMITS = {"speed": 2.0, "track": 0.15, "acceleration": 20.0}
TURN = Trajectory(Line([0.0], [2.0]), RestToRest(2.0, duration=1.0))
COARSE = rp.Mesh(dt=0.05, refinements=0)


def link(name: str, mass: float) -> str:
    moments = " ".join(f'{axis}="{INERTIA}"' for axis in ("ixx", "iyy", "izz"))
    inertia = f'<inertia {moments} ixy="0" ixz="0" iyz="0"/>'
    return f'<link name="{name}"><inertial><mass value="{mass}"/>{inertia}</inertial></link>'


def joint(name: str, kind: str, parent: str, child: str, place: float, axis: str, ends: float, speed: float) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{place} 0 0"/><axis xyz="{axis}"/>'
        f'<limit lower="{-ends}" upper="{ends}" effort="1000" velocity="{speed}"/></joint>'
    )


def machine(folder: Path, *sliders: tuple[str, float]) -> Robot:
    """Return a bar that a motor turns, with sliders along it: what carries each, and its place there, m."""
    parts = ['<link name="base"/>', link("bar", 1.0), joint("motor", "revolute", "base", "bar", 0.0, "0 0 1", 3, 100)]
    carriers = []
    for number, (parent, place) in enumerate(sliders):
        name = f"slide_{number}"
        parts.append(link(f"slider_{number}", MASS))
        parts.append(joint(name, "prismatic", parent, f"slider_{number}", place, "1 0 0", 0.15, LIMITS["speed"]))
        carriers.append({"joint": name, "acceleration": LIMITS["acceleration"]})
    (folder / "bar.urdf").write_text(f'<robot name="bar">{"".join(parts)}</robot>')
    content = {"name": "bar", "urdf": "bar.urdf", "actuated": ["motor"], "carriers": carriers}
    (folder / "robot.yaml").write_text(yaml.safe_dump(content | {"independent": {"joints": ["motor"]}}))
    return rp.load_robot(folder)


@pytest.mark.parametrize(
    ("end", "further"),
    [("datum", {}), ("free", {"jerk": 60.0}), ("periodic", {"effort": 0.3}), ("rest", {"jerk": 120.0})],
)
def test_a_carrier_on_a_carrier_has_the_optimum_of_its_own_equations(
    tmp_path: Path, end: End, further: dict[str, float]
) -> None:
    """Both positions are in the moment of inertia, and their product: f is no sum of terms of one carrier each.

    With limits of jerk and efforts, and with every end, which change the optimum.
    """
    robot = machine(tmp_path, ("bar", REACH), ("slider_0", 0.0))

    def bodies(x, s):  # type: ignore[no-untyped-def]
        places = (0.0, REACH + s[0], REACH + s[0] + s[1])
        return [
            (mass, INERTIA, r * symbolic_mechanisms._u(x), x) for mass, r in zip((1.0, MASS, MASS), places, strict=True)
        ]

    own = symbolic_mechanisms.mechanism(1, 2, bodies, lambda x: x)
    plan = rp.plan_whole_trajectory(
        robot,
        TURN,
        objective=rp.Objective("effort", calm=0.0),
        mesh=COARSE,
        limits=rp.Limits(effort=further.get("effort"), jerk=further.get("jerk")),
        end=end,
    )
    assert plan.findings.optimal
    least, _ = symbolic_plans.solve(own, TURN, plan, "effort", LIMITS | further, end=end)
    np.testing.assert_allclose(plan.least_cost, least, rtol=1e-4)
    # Lagrange's equation of the bar, and Newton's of the sliders along it
    (s1, s2), (v1, v2), (a1, a2) = (part.T for part in (plan.carriers.s, plan.carriers.sd, plan.carriers.sdd))
    r1, r2 = REACH + s1, REACH + s1 + s2
    w, wd = plan.motion.xd[:, 0], plan.motion.xdd[:, 0]
    moment = (3.0 * INERTIA + MASS * (r1**2 + r2**2)) * wd + 2.0 * MASS * (r1 * v1 + r2 * (v1 + v2)) * w
    np.testing.assert_allclose(plan.tau[:, 0], moment, atol=1e-6 * np.abs(moment).max())
    outer = MASS * (a1 + a2 - r2 * w**2)
    forces = np.stack([MASS * (a1 - r1 * w**2) + outer, outer], axis=1)
    np.testing.assert_allclose(plan.carrier_force, forces, atol=1e-6 * np.abs(forces).max())
    assert np.abs(s1 * s2).max() > 1e-3


def test_mirrored_optima_of_one_cost_are_two(tmp_path: Path) -> None:
    """A slider at the axis may go either way: τ = (I + m s²) θ̈ + 2 m s ṡ θ̇ is the same for s and −s."""
    robot = machine(tmp_path, ("bar", 0.0))
    plan = rp.plan_whole_trajectory(
        robot,
        TURN,
        objective=rp.Objective("effort", calm=0.0),
        mesh=COARSE,
        limits=rp.Limits(acceleration=2.0, speed=0.3),
        solver=rp.Solver(starts=4),
    )
    best, mirrored, parked = plan.diagnostics["starts"]["optima"]
    assert mirrored["cost"] == pytest.approx(best["cost"], rel=1e-9)
    assert parked["starts"] == [0]
    assert sorted(best["starts"] + mirrored["starts"]) == [1, 2, 3]
    assert np.abs(plan.carriers.s).max() > 0.01


def test_bounds_of_objectives_are_saved_and_lead_to_the_same_plan(tmp_path: Path) -> None:
    robot = machine(tmp_path, ("bar", REACH))
    least = rp.plan_whole_trajectory(robot, TURN, mesh=COARSE)
    force = float(least.diagnostics["objective"]["effort"])  # type: ignore[index]
    bounds = {"effort": 1.02 * force}
    plan = rp.plan_whole_trajectory(robot, TURN, objective="carrier_acceleration", at_most=bounds, mesh=COARSE)
    plan.save(tmp_path / "plan.npz")
    stated = rp.load_plan(tmp_path / "plan.npz").parameters
    assert stated["at_most"] == bounds
    again, free = (
        rp.plan_whole_trajectory(robot, TURN, objective=stated["objective"], at_most=at_most, mesh=COARSE)  # type: ignore[arg-type]
        for at_most in (stated["at_most"], None)
    )
    np.testing.assert_array_equal(again.tau, plan.tau)
    assert np.abs(free.carriers.s).max() < 1e-9 < np.abs(plan.carriers.s).max()


def test_steps_of_least_effort_need_a_motor_for_each_carrier(tmp_path: Path) -> None:
    """Two sliders have one torque to choose: there are many steps of the least one."""
    robot = machine(tmp_path, ("bar", REACH), ("bar", -REACH))
    with pytest.raises(UnsupportedRobotError, match="1 main actuators and 2 carriers") as caught:
        rp.plan_stepwise(robot, TURN, mesh=rp.Mesh(dt=0.05))
    assert (caught.value.details["m"], caught.value.details["k"]) == (1, 2)
    assert rp.plan_whole_trajectory(robot, TURN, mesh=COARSE).findings.optimal
