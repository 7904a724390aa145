"""Forward dynamics: one evaluation by both ways, and simulated time per wall time.

The yardstick of an evaluation is Pinocchio's ``constraintDynamics``, compiled code for point closures and bodies with
mass. The motion is that of the 3-RRR with its carriers, thrown from its reference pose without efforts, through
singular poses; the whole of ``simulate`` is timed, its report included.
"""

import statistics
import time

import numpy as np

import redundancy_pin as rp
from redundancy_pin.planners.reference import plan_reference
from redundancy_pin.simulation import Constant, ForwardDynamics, Sampling, closed_state
from redundancy_pin.simulation.controllers import ComputedTorque, TimeVaryingLqr
from redundancy_pin.simulation.system import ConstraintDynamics

REPEATS = 5
CALLS = 500
TARGET_US = 30.0
DURATION = 2.0


def seconds(action):
    start = time.process_time()
    result = action()
    return time.process_time() - start, result


def evaluation(robot):
    dynamics, compiled = ForwardDynamics(robot), ConstraintDynamics(robot)
    start = closed_state(robot, xd=[0.3, -0.2, 0.5], s=0.1, sd=0.4)
    q, v, force = np.array(start.q), np.array(start.v), np.ones(robot.model.nv)
    dynamics.adapt(q)
    ours, theirs, ratios = [], [], []
    for _ in range(2 * REPEATS):
        a, mine = seconds(lambda: [dynamics.acceleration(q, v, force) for _ in range(CALLS)][-1])
        b, other = seconds(lambda: [compiled(q, v, force) for _ in range(CALLS)][-1])
        ours.append(1e6 * a / CALLS)
        theirs.append(1e6 * b / CALLS)
        ratios.append(a / b)
    row = {
        "what": "accelerations of the 3-RRR with carriers, projected equations against Pinocchio's constraintDynamics",
        "projected_us": min(ours),
        "constraint_dynamics_us": min(theirs),
        "ratio": statistics.median(ratios),
        "target_us": TARGET_US,
        "relative_difference": float(np.abs(mine - other).max() / np.abs(mine).max()),
    }
    print(
        f"{row['what']}: {row['projected_us']:.1f} us (target {TARGET_US:.0f}), "
        f"{row['constraint_dynamics_us']:.1f} us; they differ by {row['relative_difference']:.1e}"
    )
    return row


def whole(robot, title, drive, **options):
    start = closed_state(robot, xd=[0.3, -0.2, 0.5], s=0.1, sd=0.1)
    rates = []
    for _ in range(REPEATS):
        spent, run = seconds(
            lambda: rp.simulate(robot, drive, start=start, duration=DURATION, dt=0.01, stop_at=(), **options)
        )
        rates.append(DURATION / spent)
    row = {
        "what": f"simulated time per processor time, 3-RRR with carriers, {title}",
        "ratio": statistics.median(rates),
        "steps": run.statistics.steps,
        "evaluations": run.statistics.evaluations,
        "gap": float(run.gap.max()),
        "energy_drift": float(np.ptp(run.energy) / np.abs(run.energy).max()),
    }
    print(
        f"{row['what']}: {row['ratio']:.1f} ({row['steps']} steps, {row['evaluations']} evaluations, gap "
        f"{row['gap']:.0e} m, energy drift {row['energy_drift']:.0e})"
    )
    return row


def compiled(title, robot, drive=None, law=None, repeats=REPEATS, **options):
    """One simulation with and without compiled dynamics, in turn; a law takes them too.

    A law is asked in Python at each stage of the integrator, which is most of its time: the target is lower.
    """
    target = 5.0 if law is None else 2.0
    dynamics = rp.CompiledDynamics(robot)
    before, after = (drive, drive) if law is None else (law(drive), law(drive, dynamics=dynamics))
    rp.simulate(robot, after, dynamics=dynamics, **options)  # which compiles them
    pairs = []
    for _ in range(repeats):
        own, was = seconds(lambda: rp.simulate(robot, before, **options))
        code, run = seconds(lambda: rp.simulate(robot, after, dynamics=dynamics, **options))
        pairs.append((own, code, was.statistics.seconds / run.statistics.seconds))
    span = float(run.t[-1] - run.t[0])
    row = {
        "what": f"simulated time per processor time with compiled dynamics, {title}",
        "ratio": statistics.median(own / code for own, code, _ in pairs),
        "target": target,
        "without": span / statistics.median(own for own, _, _ in pairs),
        "with": span / statistics.median(code for _, code, _ in pairs),
        "integration": statistics.median(ratio for *_, ratio in pairs),
        "difference": float(np.abs(run.q - was.q).max()),
    }
    print(
        f"{row['what']}: {row['with']:.1f}, without {row['without']:.2f}: {row['ratio']:.1f} times "
        f"(target {target:g}), the integration alone {row['integration']:.0f}; they differ by {row['difference']:.0e}",
        flush=True,
    )
    return row


def compiled_rows():
    """A plan of the 3-RRR, open loop and from a millimetre off it, a crossing of the 2-RPR, a four-bar let go."""
    reference = rp.trajectory.reference
    corner = rp.load_robot("3rrr")
    line = rp.load_robot("2rpr", end_effector_mass=0.5, cylinder_mass=0.3, piston_mass=0.2)
    crank = rp.load_robot("four_bar")
    plans = [
        rp.plan_whole_trajectory(rp.RneaDynamics(robot), motion)
        for robot, motion in ((corner, reference.corner(0.025)), (line, reference.line(0.4, ramp_time=0.5)))
    ]
    course = plan_reference(plans[0], robot=corner)
    point = course.at(0.7)
    away = {"start": closed_state(corner, point.x + 1e-3, point.xd, point.s, point.sd, t=0.7), "repeats": 2}
    return [
        compiled("plan of the 3-RRR corner", corner, plans[0], stop_at=()),
        compiled("LQR at every instant along it", corner, course, TimeVaryingLqr, **away, stop_at=()),
        compiled("computed torque at every instant along it", corner, course, ComputedTorque, **away, stop_at=()),
        compiled("plan of the 2-RPR line, through a type II pose", line, plans[1], stop_at=()),
        compiled("four-bar let go", crank, start=closed_state(crank, xd=[3.0]), duration=5.0),
    ]


def rows():
    robot = rp.load_robot("3rrr")
    nothing = Constant(np.zeros(robot.m), np.zeros(robot.k))
    return [
        *compiled_rows(),
        evaluation(robot),
        whole(robot, "projected equations", nothing),
        whole(robot, "Pinocchio's constraintDynamics", nothing, method="constraint_dynamics"),
        whole(robot, "1 kHz controller, one sample of delay", nothing, sampling=Sampling(1e-3, 1e-3)),
        whole(
            robot,
            "1 kHz controller, order 5 at 1e-7",
            nothing,
            sampling=Sampling(1e-3, 1e-3),
            integrator="RK45",
            rtol=1e-7,
            atol=1e-8,
        ),
    ]


if __name__ == "__main__":
    rows()
