"""A task of tests/oracles/engines by Drake: the tree of a robot, its pins as ball constraints of a discrete plant.

Drake's constraints belong to its discrete solver (SAP), whose steps are of first order: 1.6 mm off after 1.8 s of the
corner with steps of 1 ms, 0.23 mm with 0.2 ms. A continuous plant refuses them. Joints that turn or slide about an
axis of their frame, and bodies with mass.
"""

import time

import numpy as np
from engines.links import link_tree
from engines.run import Raw, finished

from redundancy_pin.robot.lookup import find_link


def plant_of(robot, step):
    """Return a finalized plant."""
    import pydrake.all as drake

    model, plant = robot.model, drake.MultibodyPlant(step)
    plant.set_discrete_contact_approximation(drake.DiscreteContactApproximation.kSap)
    plant.mutable_gravity_field().set_gravity_vector(model.gravity.linear)
    bodies = [plant.world_body()]
    for index, joint in enumerate(model.joints[1:], start=1):
        body, place = model.inertias[index], model.jointPlacements[index]
        entries = (body.inertia[at] for at in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
        central = drake.RotationalInertia(*entries)
        moved = plant.AddRigidBody(
            f"body_{index}", drake.SpatialInertia.MakeFromCentralInertia(body.mass, body.lever, central)
        )
        transform = drake.RigidTransform(drake.RotationMatrix(place.rotation), place.translation)
        frame = drake.FixedOffsetFrame(f"frame_{index}", bodies[model.parents[index]], transform)
        kind = drake.RevoluteJoint if joint.shortname().startswith("JointModelR") else drake.PrismaticJoint
        axis = np.eye(3)["XYZ".index(joint.shortname()[-1])]
        plant.AddJoint(
            kind(f"joint_{index}", frame_on_parent=plant.AddFrame(frame), frame_on_child=moved.body_frame(), axis=axis)
        )
        bodies.append(moved)
    for closure in robot.closures:
        ends = [find_link(model, name) for name in (closure.frame_a, closure.frame_b)]
        plant.AddBallConstraint(
            *(part for end in ends for part in (bodies[end.parentJoint], end.placement.translation))
        )
    plant.Finalize()
    return plant


def run_drake(task, *, step):
    """Integrate a task with Drake, its efforts held at those in the middle of a step; as ``engines.run_mujoco``."""
    import pydrake.all as drake

    robot, count = task.robot, round(task.duration / step)
    step = task.duration / count
    t = task.start + step * np.arange(count + 1)
    efforts = np.zeros((count, robot.model.nv))
    efforts[:, [*robot.actuated_velocity, *robot.carrier_velocity]] = task.efforts(t[:-1] + 0.5 * step)
    plant = plant_of(robot, step)
    simulator = drake.Simulator(plant)
    context = simulator.get_mutable_context()
    context.SetTime(task.start)
    plant.SetPositionsAndVelocities(context, np.concatenate([task.q, task.v]))
    held = plant.get_applied_generalized_force_input_port().FixValue(context, efforts[0])
    states = np.empty((count + 1, robot.model.nq + robot.model.nv))
    states[0] = plant.GetPositionsAndVelocities(context)
    began = time.perf_counter()
    for k in range(count):
        held.GetMutableData().set_value(efforts[k])
        simulator.AdvanceTo(t[k + 1])
        states[k + 1] = plant.GetPositionsAndVelocities(context)
    seconds = time.perf_counter() - began
    tree = link_tree(robot)
    q, v = np.split(states, [robot.model.nq], axis=1)
    raw = Raw(t, np.array([*map(tree.from_q, q)]), np.array([*map(tree.from_v, v)]), seconds, "")
    return finished(tree, task, raw, "drake", "", {"step": step})
