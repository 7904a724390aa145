"""Robots, motions, dynamics, results and plans are copied, pickled and sent to another process, and stay read-only."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import FrozenInstanceError, fields, is_dataclass
from typing import Any

import numpy as np
import pytest
from copies import arrays_of, digest, types_of
from forked import import_all

import redundancy_pin as rp
from redundancy_pin.arrays import ByValue, Frozen
from redundancy_pin.crosscheck import run
from redundancy_pin.dynamics.allocation import CarrierForces, allocate
from redundancy_pin.dynamics.compiled import design_of
from redundancy_pin.dynamics.compiled.parameters import layout_of, numbers_of, topology_of
from redundancy_pin.dynamics.contacts import closure_forces
from redundancy_pin.dynamics.virtual_work import three_rrr, two_rpr
from redundancy_pin.identification import BaseParameters, Fit, Records
from redundancy_pin.identification.exciting import ExcitingMotion
from redundancy_pin.identification.records import SmoothMotion
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.planners.carrier_return import CarrierState
from redundancy_pin.planners.optimal.co_design import CoDesign, DesignTask
from redundancy_pin.planners.options import Limits, Objective
from redundancy_pin.planners.receding_horizon import Command
from redundancy_pin.planners.receding_horizon.preview import Preview
from redundancy_pin.planners.receding_horizon.run import OnLineRun
from redundancy_pin.planners.singular_instant import SingularInstant
from redundancy_pin.simulation import ForwardDynamics, closed_state, inverse_derivatives, linearise
from redundancy_pin.status import ResultStatus, UpdateStatus
from redundancy_pin.trajectory.continuous_motion import as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.time_scaling import ScaledMotion, TimeScaling
from redundancy_pin.trajectory.timing import RestToRest, TimingLaw

ELSEWHERE = {"Riccati", "LinearModel", "SampledModel", "LqrWeights", "ReferencePoint", "ConstantAppended"}
"""Inner types of controllers and paths, whose owners are copied whole."""


@pytest.fixture(scope="module")
def objects() -> dict[str, Any]:
    robot, small = rp.load_robot("3rrr"), rp.load_robot("2rpr")
    trajectory, circle = rp.trajectory.reference.corner(radius=0.025), rp.trajectory.reference.circle(speed=0.5)
    motion = trajectory.sample(dt=0.02)
    carriers = rp.CarrierMotion.parked(len(motion), robot.k)
    dynamics, manual = rp.RneaDynamics(robot), rp.VirtualWork(robot)
    along = dynamics.along(motion)
    reduced = along.reduce(carriers)
    efforts = rp.distribute(reduced)
    branch = follower(small)
    along.base_wrench()  # makes its pools
    compiled = rp.CompiledDynamics(robot).along(motion)
    start = closed_state(robot, xd=[0.1, 0.0, 0.0])
    three = np.ones(3)
    polynomial = PiecewisePolynomial(np.arange(2.0), np.ones((3, 1, 3)))
    poses = np.stack([np.eye(4), np.eye(4)])
    poses[1, :3, 3] = 0.1
    return {
        "robot": robot,
        "loaded": robot.loaded(
            rp.Wrench("platform", np.ones((3, 6))), rp.Payload("platform", 1.0), rp.Spring("base", "platform")
        ),
        "trajectory": trajectory,
        "circle": circle,
        "motion": motion,
        "carriers": carriers,
        "dynamics": dynamics,
        "virtual work": manual,
        "along": along,
        "virtual work along": manual.along(motion),
        "compiled along": compiled,
        "derivatives of compiled": compiled.derivatives(carriers, parameters=["carrier_1.mass"]),
        "design": design_of(robot, ["carrier_1.mass"]),
        "numbers": numbers_of(robot),
        "layout": layout_of(topology_of(robot)),
        "design task": DesignTask(dynamics, motion),
        "co-design": CoDesign({"length": 1.0}, (), np.ones(1), np.ones(1), np.ones((1, 1)), (), True, (), 0),
        "preview": Preview.of(motion),
        "slower motion": ScaledMotion(as_motion(motion), TimeScaling.none(0.0).changed(0.1, 0.5, 0.2)),
        "on-line run": OnLineRun(
            (stepwise := rp.plan_stepwise(dynamics, trajectory, mesh=rp.Mesh(dt=0.05))),
            (Command(0.0, UpdateStatus.OK, "", *[polynomial] * 3, 0.0, 0.0, three, 0.1, 0.0),),
        ),
        "symbolic": rp.symbolic(small),
        "legs": three_rrr.inverse_displacement(three_rrr.ThreeRrrGeometry.from_parameters(robot.parameters), motion.x),
        "two legs": two_rpr.inverse_displacement(small.parameters["base_distance"], circle.sample(dt=0.1).x),
        "reduced": reduced,
        "fastest law": TimingLaw(RestToRest(0.1, 1.0).curve, 0.1, 0.9),
        "singular instant": SingularInstant(0.1, *[np.ones((1, 1))] * 3, three, three, 1.0, three, 1.0),
        "derivatives": along.carrier_derivatives(carriers),
        "one sample": dynamics.sample(motion.x[0], motion.xd[0], motion.xdd[0]),
        "efforts": efforts,
        "inverse dynamics": rp.inverse_dynamics(dynamics, motion, carriers),
        "reactions": rp.joint_reactions(along, efforts.tau, carriers),
        "allocation": allocate(
            *(np.eye(3), np.eye(3), three, np.zeros(3)),
            **{"effort_scale": three, "carrier_scale": three, "row_scale": three},
            carriers=CarrierForces(three, np.eye(3), 5.0 * three),
        ),
        "carrier forces": CarrierForces(three, np.eye(3), three),
        "singularities": rp.classify_motion(along.tree),
        "forward kinematics": rp.forward_kinematics(small, [0.4, 0.5]),
        "assembly modes": rp.assembly_modes(small, [0.4, 0.5]),
        "performance": rp.performance(small, small.q_reference),
        "workspace": rp.workspace(small, bounds=[(0.0, 0.5), (0.2, 0.5)], resolution=3),
        "closure forces": (closing := closure_forces(along)),
        "rows of efforts": closing.rows(np.ones(len(closing.names)), 0.0, 1.0),
        "crossings": rp.find_crossings(small, circle),
        "locus": rp.singular_locus(small, resolution=8),
        "limits": Limits(effort=np.ones(3)),
        "objective": Objective({"effort": 1.0}, base_point=np.zeros(3)),
        "resolved": Limits().resolved(robot),
        "spline": rp.trajectory.SplinePath(np.array([[0.0, 0.0], [0.1, 0.2], [0.3, 0.1]])),
        "polynomial": rp.trajectory.rest_to_rest_345(0.0, 1.0, three, 0.0 * three),
        "poses": rp.trajectory.reference.pose(poses[0], poses[1]),
        "sampled poses": as_motion(rp.trajectory.reference.pose(poses[0], poses[1]).sample(0.1)),
        "timed spline": rp.trajectory.from_points([[0.0, 0.0], [0.1, 0.2], [0.3, 0.1]], [0.0, 1.0, 2.0]),
        "pose spline": rp.trajectory.from_points(poses, speed=[0.0, 0.1]),
        "table": rp.plan_stepwise(dynamics, trajectory.sample(dt=0.1)).table(robot=robot),
        "carrier state": CarrierState(0.0, *np.zeros((3, 3))),
        "crossing plan": rp.plan_switch_off(rp.VirtualWork(small), circle, threshold=5.0, mesh=rp.Mesh(dt=0.05)),
        "stepwise plan": stepwise,
        "state": start,
        "closed state": branch.home,
        "branch end": branch.advance(branch.home, branch.home.x * np.nan),
        "forward": ForwardDynamics(robot),
        "run": rp.simulate(robot, None, start=start, duration=0.02, stop_at=()),
        "linearised": linearise(robot, start, three),
        "inverse derivatives": inverse_derivatives(robot, start.q, start.v, np.zeros(robot.model.nv)),
        "report": run(["2rpr"], samples=1),
        "records": (records := Records(np.arange(2.0), np.ones((2, 3)), platform=np.ones((2, 3)))),
        "smooth motion": SmoothMotion(motion, carriers, slice(1, 3), *[three] * 5, (three,) * 3, three),
        "base parameters": (base := BaseParameters((), np.arange(0), np.ones((0, 0)), ("mass",))),
        "exciting motion": ExcitingMotion(small, 1.0, np.zeros((5, 2)), ResultStatus.OK, (), 1.0, base, np.eye(2)),
        "fit": Fit(
            ResultStatus.OK,
            (),
            robot,
            base,
            three,
            np.eye(3),
            three,
            records.t,
            *[records.effort] * 3,
            *[three] * 3,
        ),
    }


WAYS: dict[str, Callable[[Any], Any]] = {
    "copied": copy.deepcopy,
    "pickled": lambda one: pickle.loads(pickle.dumps(one)),
    "copied shallow": copy.copy,
}


@pytest.mark.parametrize("way", WAYS)
def test_copies_hold_the_same_bits_and_none_that_can_be_changed(objects: dict[str, Any], way: str) -> None:
    for name, one in objects.items():
        other = WAYS[way](one)
        before, after = digest(one), digest(other)
        for path, part, owner in arrays_of(other):
            if isinstance(owner, Frozen):
                bits, writeable = before[path]
                assert bits == part.tobytes(), f"{name}{path}"
                assert not part.flags.writeable or (writeable and way == "copied shallow"), f"{name}{path}"
        assert {path for path in before if "chain" not in path} <= set(after) | {
            path for path, _, owner in arrays_of(one) if not isinstance(owner, Frozen)
        }, name


def test_no_field_of_them_can_be_set(objects: dict[str, Any]) -> None:
    for name, one in objects.items():
        if is_dataclass(one):
            with pytest.raises(FrozenInstanceError):
                setattr(one, fields(one)[0].name, name)


@pytest.mark.long
def test_another_process_gets_the_same(objects: dict[str, Any]) -> None:
    names = [name for name in objects if name not in ("state", "forward")]  # evaluators are made anew there
    # an executor says so where a process cannot read what it gets; a pool would wait for ever
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        there = list(pool.map(digest, [objects[name] for name in names]))
    for name, other in zip(names, there, strict=True):
        frozen = {path for path, _, owner in arrays_of(objects[name]) if isinstance(owner, Frozen)}
        here = digest(objects[name])
        assert {path: (here[path][0], False) for path in frozen} == {path: other[path] for path in frozen}, name


def test_every_type_with_read_only_arrays_is_among_them(objects: dict[str, Any]) -> None:
    import_all()  # or it would depend on which tests this worker has run before
    types = {kind.__name__ for kind in types_of(objects)}
    pending, every = [Frozen], set()
    while pending:
        kind = pending.pop()
        pending += kind.__subclasses__()
        every.add(kind.__name__)
    assert every - types - ELSEWHERE - {"Frozen", "ByValue"} == set()


def test_results_are_compared_by_what_they_are_and_not_by_their_arrays(objects: dict[str, Any]) -> None:
    """Equality of arrays has no truth value; what is compared by identity can be a key; options are by value."""
    attributes = {name: getattr(one, "__dict__", {}) for name, one in objects.items()}
    parts = {f"{name}.{key}": part for name, each in attributes.items() for key, part in each.items()}
    with_arrays = {name: one for name, one in parts.items() if any(owner is one for *_, owner in arrays_of(one))}
    for name, one in (objects | with_arrays).items():
        if isinstance(one, Frozen):
            assert {one: name}[one] == name
            assert (one == copy.deepcopy(one)) is isinstance(one, ByValue), name


def test_copies_compute_what_the_originals_do(objects: dict[str, Any]) -> None:
    motion, carriers = objects["motion"], objects["carriers"]
    for name in ("dynamics", "virtual work"):
        first, second = (one.reduce(motion, carriers) for one in (objects[name], WAYS["pickled"](objects[name])))
        assert first.f.tobytes() == second.f.tobytes()
    along = WAYS["pickled"](objects["along"])
    assert along.base_wrench(carriers).tobytes() == objects["along"].base_wrench(carriers).tobytes()
    state = objects["state"]
    force = np.ones(objects["robot"].model.nv)
    expected = objects["forward"].acceleration(state.q, state.v, force)
    for one in (copy.deepcopy(objects["forward"]), WAYS["pickled"](objects["forward"])):
        assert one.acceleration(state.q, state.v, force).tobytes() == expected.tobytes()
    assert WAYS["pickled"](state).xd.tobytes() == state.xd.tobytes()
    assert dict(WAYS["copied"](objects["robot"]).parameters) == dict(objects["robot"].parameters)
