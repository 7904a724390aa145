"""Forward dynamics: accelerations beside Pinocchio's and MuJoCo's, and a planned motion beside Exudyn and MuJoCo.

Pinocchio's algorithms are damped by 1e-8 and iterated to 1e-12, their arguments made once; ours include the test of
rank and the copies of a call. MuJoCo's constraints are springs. Simulations have steps that keep the planned motion to
1e-5 (m and rad), without control.
"""

import functools
import xml.etree.ElementTree as ElementTree

import engines
import numpy as np
import pinocchio as pin
import pytest
from drake_plant import run_drake
from engines.cases import CORNER, prepare

import redundancy_pin as rp
from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.robot.lookup import find_link
from redundancy_pin.robot.shipped import shipped_robots
from redundancy_pin.simulation import closed_state
from redundancy_pin.writers import mjcf

MASSES = {
    "2rpr": {"end_effector_mass": 0.5, "cylinder_mass": 0.8, "piston_mass": 0.4},
    "five_bar": {"end_effector_mass": 0.3},
}
"""Of parts that are massless by default: Pinocchio's factorisations need them."""

SAME = 1e-6
"""Of the largest acceleration: what Pinocchio's damping leaves."""

OWN = {"integrator": "RK45", "rtol": 1e-6, "atol": 1e-7}
"""Settings of ``simulate`` for 1e-5 m, a step for each of the plan; the engines take steps of 2.5 ms for it."""


def ours(robot, q, v, force):
    dynamics, tau = rp.CompiledDynamics(robot), force[robot.actuated_velocity]
    return lambda: dynamics.acceleration(q, v, tau).a


def pinocchios(algorithm, robot, q, v, force):
    model, data = robot.model, robot.model.createData()
    constraints, own = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    for closure in robot.closures:
        ends = [find_link(model, name) for name in (closure.frame_a, closure.frame_b)]
        kind = pin.ContactType.CONTACT_6D if len(closure.axes) == 6 else pin.ContactType.CONTACT_3D
        places = [part for end in ends for part in (end.parentJoint, end.placement)]
        constraint = pin.RigidConstraintModel(kind, model, *places, pin.ReferenceFrame.LOCAL)
        constraints.append(constraint)
        own.append(constraint.createData())
    if algorithm == "lcaba":
        pin.computeJointMinimalOrdering(model, data, constraints)
    else:
        pin.initConstraintDynamics(model, data, constraints, own)
    arguments = (model, data, q, v, force, constraints, own, pin.ProximalSettings(1e-12, 1e-8, 30))
    return functools.partial(getattr(pin, algorithm), *arguments)


def mujocos(robot):
    mujoco = pytest.importorskip("mujoco")
    try:
        text = ElementTree.tostring(mjcf(robot, 1e-3, 2e-3, 0.9999, "RK4"), encoding="unicode")
        model = mujoco.MjModel.from_xml_string(text)
    except (RedundancyPinError, ValueError) as error:
        pytest.skip(f"MuJoCo does not express it: {error}")
    return functools.partial(mujoco.mj_forward, model, mujoco.MjData(model))


@pytest.mark.parametrize("who", ["Pinocchio constraintDynamics", "Pinocchio lcaba", "MuJoCo mj_forward", "generated C"])
@pytest.mark.parametrize("name", shipped_robots())
def test_accelerations(benchmark, name, who):
    benchmark.group = f"accelerations from (q, v, τ), {name}"
    robot = rp.load_robot(name, **MASSES.get(name, {}))
    state, force = closed_state(robot, xd=np.full(robot.n, 0.1)), np.zeros(robot.model.nv)
    q, v = np.array(state.q), np.array(state.v)
    force[robot.actuated_velocity] = 0.3
    if who.startswith("MuJoCo"):
        call = mujocos(robot)
    else:
        _, _, algorithm = who.partition("Pinocchio ")
        call = pinocchios(algorithm, robot, q, v, force) if algorithm else ours(robot, q, v, force)
        expected = ours(robot, q, v, force)()
        assert np.abs(np.array(call()) - expected).max() < SAME * np.abs(expected).max()
    benchmark.extra_info["units"] = 1
    call()
    benchmark.pedantic(call, rounds=15, iterations=500)


@pytest.mark.benchmark(group="a planned motion of the 3-RRR simulated to 1e-5 m, a second of it")
@pytest.mark.parametrize(
    "who", ["Exudyn", "MuJoCo", "Drake, to 2e-3 m only", "rp.simulate", "rp.simulate, generated C"]
)
def test_simulation(benchmark, who):
    drive, least = prepare(CORNER, rp.CompiledDynamics), 1e-5
    if who.startswith("Drake"):
        pytest.importorskip("pydrake", reason="`pip install drake` brings it")
        integrate, least = functools.partial(run_drake, step=1e-3), 2e-3
    elif who in ("Exudyn", "MuJoCo"):
        pytest.importorskip(who.lower())
        integrate = functools.partial(getattr(engines, f"run_{who.lower()}"), step=2.5e-3)
    else:
        dynamics = rp.CompiledDynamics(drive.task.robot) if "generated" in who else None
        integrate = functools.partial(engines.run_own, dt=0.02, dynamics=dynamics, **OWN)
    benchmark.extra_info["units"] = drive.task.duration
    integrate(drive.task)
    run = benchmark.pedantic(integrate, (drive.task,), rounds=3)
    assert engines.deviation(drive, run).largest < least
