"""One sample from Python: accelerations beside Pinocchio's and MuJoCo's, and a 1 kHz loop, as ratios within one run.

    python benchmarks/control_rate.py            the table of docs/compiled.md, as markdown
    python benchmarks/control_rate.py --calls    1e7 calls, and the memory of the process after each million

Accelerations of a closed chain from (q, v, tau): ``CompiledDynamics.acceleration``, its test of rank and its copies
included, against ``pin.constraintDynamics`` and ``pin.lcaba`` (mu = 1e-8, iterated to 1e-12, arguments made once) and
``mj_forward``, whose constraints are springs. The state is the reference in motion; arguments of ours are arrays.
"""

import importlib.util
import resource
import statistics
import sys
import time
import xml.etree.ElementTree as ElementTree

import numpy as np
import pinocchio as pin

import redundancy_pin as rp
from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.robot.lookup import find_joint, find_link
from redundancy_pin.robot.shipped import shipped_robots
from redundancy_pin.simulation import closed_state
from redundancy_pin.writers import mjcf

REPEATS = 15
CALLS = 1000
STEPS = 1000
"""Samples of the loop: a second at 1 kHz."""

MASSES = {
    "2rpr": {"end_effector_mass": 0.5, "cylinder_mass": 0.8, "piston_mass": 0.4},
    "five_bar": {"end_effector_mass": 0.3},
}
"""Of parts that are massless by default: Pinocchio's factorisations need them."""

TARGETS = {"torque": 15.0, "joint_state": 15.0, "acceleration": 15.0}
"""us a call, 3-RRR."""


def best(calls):
    """Return the least time of each call, us, all in turn: what other programs take of the machine only adds."""
    times = {name: [] for name in calls}
    for _ in range(REPEATS):
        for name, call in calls.items():
            start = time.perf_counter()
            for _ in range(CALLS):
                call()
            times[name].append(time.perf_counter() - start)
    return {name: 1e6 * min(each) / CALLS for name, each in times.items()}


def pinocchio_calls(robot, q, v, force):
    """Return Pinocchio's two algorithms as functions of nothing."""
    model = robot.model
    constraints = pin.StdVec_RigidConstraintModel()
    for closure in robot.closures:
        ends = [find_link(model, name) for name in (closure.frame_a, closure.frame_b)]
        kind = pin.ContactType.CONTACT_6D if len(closure.axes) == 6 else pin.ContactType.CONTACT_3D
        places = [part for end in ends for part in (end.parentJoint, end.placement)]
        constraints.append(pin.RigidConstraintModel(kind, model, *places, pin.ReferenceFrame.LOCAL))
    result = {}
    for name, algorithm in (("constraintDynamics", pin.constraintDynamics), ("lcaba", pin.lcaba)):
        data, own = model.createData(), pin.StdVec_RigidConstraintData()
        for constraint in constraints:
            own.append(constraint.createData())
        if name == "lcaba":
            pin.computeJointMinimalOrdering(model, data, constraints)
        else:
            pin.initConstraintDynamics(model, data, constraints, own)
        settings = pin.ProximalSettings(1e-12, 1e-8, 30)
        arguments = (model, data, q, v, force, constraints, own, settings)
        result[name] = lambda algorithm=algorithm, arguments=arguments: algorithm(*arguments)
    return result


def mujoco_call(robot):
    """Return MuJoCo's forward dynamics of a robot as a function of nothing, or None where it cannot express it."""
    if importlib.util.find_spec("mujoco") is None:
        return None
    import mujoco

    try:
        text = ElementTree.tostring(mjcf(robot, 1e-3, 2e-3, 0.9999, "RK4"), encoding="unicode")
        model = mujoco.MjModel.from_xml_string(text)
    except (RedundancyPinError, ValueError):
        return None
    data = mujoco.MjData(model)
    return lambda: mujoco.mj_forward(model, data)


def accelerations():
    """Return a row for each shipped robot, and print them as a table."""
    print(
        "| robot | nv | closures | ours, us | constraintDynamics, us | lcaba, us | mj_forward, us | ratio | differ by |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|---:|---:|")
    rows = []
    for name in shipped_robots(gallery=True):
        robot = rp.load_robot(name, **MASSES.get(name, {}))
        dynamics = rp.CompiledDynamics(robot)
        state = closed_state(robot, xd=np.full(robot.n, 0.1))
        q, v, tau, force = np.array(state.q), np.array(state.v), np.full(robot.m, 0.3), np.zeros(robot.model.nv)
        force[robot.actuated_velocity] = tau
        others = pinocchio_calls(robot, q, v, force)
        calls = {"ours": lambda q=q, v=v, tau=tau, dynamics=dynamics: dynamics.acceleration(q, v, tau), **others}
        mujoco = mujoco_call(robot)
        if mujoco is not None:
            calls["mj_forward"] = mujoco
        expected = others["constraintDynamics"]()
        off = np.abs(dynamics.acceleration(q, v, tau).a - expected).max() / np.abs(expected).max()
        us = best(calls)
        ratio = us["ours"] / min(us["constraintDynamics"], us["lcaba"])
        rows.append({"what": f"accelerations of {name}", "ratio": ratio, "target": 1.0, "us": us, "difference": off})
        numbers = [
            f"{us[key]:.1f}" if key in us else "" for key in ("ours", "constraintDynamics", "lcaba", "mj_forward")
        ]
        print(
            f"| {name} | {robot.model.nv} | {len(robot.closures)} | {' | '.join(numbers)} | {ratio:.2f} | {off:.0e} |",
            flush=True,
        )
    return rows


def smooth(robot):
    """Return a second of platform and carrier motion about the reference, at 1 kHz."""
    t = np.arange(STEPS) / STEPS
    home = closed_state(robot).x
    size = 0.05 * robot.characteristic_length
    push, rate, second = (f(2.0 * np.pi * t)[:, None] * size for f in (np.sin, np.cos, lambda a: -np.sin(a)))
    x = np.repeat(home[None], STEPS, axis=0)
    xd, xdd = np.zeros((2, STEPS, robot.n))
    moving = slice(0, min(robot.n, 3 if home.ndim == 2 else 2))
    if home.ndim == 2:
        x[:, moving, 3] += push
    else:
        x[:, moving] += push
    xd[:, moving], xdd[:, moving] = 2.0 * np.pi * rate, (2.0 * np.pi) ** 2 * second
    return x, xd, xdd


def loop(name):
    """Time the three calls of a control loop, each at samples of a motion, one after the other."""
    robot = rp.load_robot(name, **MASSES.get(name, {}))
    dynamics = rp.CompiledDynamics(robot)
    x, xd, xdd = smooth(robot)
    tree = rp.inverse_kinematics(robot, rp.PlatformMotion(np.arange(STEPS) / STEPS, x, xd, xdd))
    q, v = np.array(tree.q), np.array(tree.v)
    at = [find_joint(robot.model, joint).idx_q for joint in robot.actuated]
    motors, rates = np.ascontiguousarray(q[:, at]), np.ascontiguousarray(v[:, robot.actuated_velocity])
    tau = np.array([dynamics.torque(*row).tau for row in zip(x, xd, xdd, strict=True)])
    parts = {
        "torque": lambda: [dynamics.torque(x[k], xd[k], xdd[k]) for k in range(STEPS)],
        "joint_state": lambda: [dynamics.joint_state(motors[k], rates[k]) for k in range(STEPS)],
        "acceleration": lambda: [dynamics.acceleration(q[k], v[k], tau[k]) for k in range(STEPS)],
    }
    us = {}
    for call, part in parts.items():
        times = []
        for _ in range(REPEATS):
            start = time.perf_counter()
            part()
            times.append(time.perf_counter() - start)
        us[call] = 1e6 * min(times) / STEPS
    share = sum(us.values()) * 1e-3
    print(
        f"{name}: torque {us['torque']:.1f}, joint_state {us['joint_state']:.1f}, acceleration "
        f"{us['acceleration']:.1f} us a call; all three at 1 kHz take {100.0 * share:.1f} % of a core",
        flush=True,
    )
    return {"what": f"one sample from Python, {name}", "us": us, "targets": TARGETS, "share_of_a_core": share}


def memory(calls=10_000_000, every=1_000_000):
    """Print the largest memory of the process, MB, every million calls."""
    robot = rp.load_robot("3rrr")
    dynamics = rp.CompiledDynamics(robot)
    home, zero = closed_state(robot).x, np.zeros(3)
    q, v = np.array(robot.q_reference), np.zeros(robot.model.nv)
    motors = q[[find_joint(robot.model, joint).idx_q for joint in robot.actuated]]
    for _ in range(calls // every):
        for _ in range(every // 4):
            dynamics.torque(home, zero, zero)
            dynamics.torque(home * np.nan, zero, zero)
            dynamics.acceleration(q, v, zero)
            dynamics.joint_state(motors, zero)
        print(f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.2f} MB", flush=True)


def rows():
    """Return the rows of the report."""
    result = accelerations()
    worst = max(row["ratio"] for row in result)
    middle = statistics.median(row["ratio"] for row in result)
    print(f"ratio of accelerations to the faster of Pinocchio's: median {middle:.2f}, worst {worst:.2f} (target 1)")
    return [*result, *(loop(name) for name in ("3rrr", "delta", "gough"))]


if __name__ == "__main__":
    memory() if "--calls" in sys.argv else rows()
