"""The expressions that machine code is made of, as they stand: against Pinocchio and the package's own kinematics."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
import spatial_chains
import zoo
from scipy.spatial.transform import Rotation

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.compiled import design
from redundancy_pin.dynamics.compiled.closing import LARGEST_TURN, parts_of, waypoints
from redundancy_pin.dynamics.compiled.parameters import parameter_vector, places_of, trig_at
from redundancy_pin.dynamics.compiled.symbols import SymbolicChain
from redundancy_pin.kinematics.assembly import project
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.kinematics.coordinates import coordinates, difference, mode_indicator, moved

CHAINS = [*zoo.SHIPPED, *spatial_chains.CHAINS]


@pytest.fixture(params=CHAINS)
def robot(request: pytest.FixtureRequest) -> rp.Robot:
    chains = spatial_chains.CHAINS
    return spatial_chains.chain_of(request.param) if request.param in chains else zoo.robot_of(request.param)


def values(chain: SymbolicChain, expressions, *, q, v=None, a=None, x=None):
    """Numbers of expressions at one state."""
    names = [chain.q, chain.v, chain.a, chain.x, chain.trig]
    zero = np.zeros(chain.model.nv)
    given = [q, zero if v is None else v, zero if a is None else a, np.zeros(chain.x.shape[0]) if x is None else x]
    function = ca.Function("f", [*names, chain.external, chain.parameters], list(expressions))
    nothing, numbers = np.zeros(chain.external.shape[0]), parameter_vector(chain.robot)
    found = function.call([*given, trig_at(chain.robot, q[None])[0], nothing, numbers])
    return [np.asarray(part) for part in found]


def test_rows_coordinates_and_modes_are_those_of_the_kinematics(robot: rp.Robot) -> None:
    chain, evaluated, system = SymbolicChain(robot), ClosedChain(robot), zoo.system_of(robot)
    rng = np.random.default_rng(7)
    steps = rng.uniform(-0.05, 0.05, (3, robot.n)) * robot.characteristic_length
    targets = moved(robot, np.repeat(zoo.home_of(robot)[None], 3, axis=0), steps)
    motion = rp.PlatformMotion(
        np.arange(3.0), targets, np.zeros((3, robot.n)), np.zeros((3, robot.n)), check_rates=False
    )
    closed = np.asarray(rp.inverse_kinematics(robot, motion).q)
    for q in closed:
        state = system.evaluate(q[None])
        xd = rng.normal(size=robot.n)
        v = project(system, state).gamma[0] @ xd
        v[robot.carrier_velocity] = rng.normal(size=robot.k)
        evaluated.update(q, v)
        bias = np.concatenate([evaluated.bias(), evaluated.platform_jacobian_rate() @ v])
        x = coordinates(robot, state)[0]
        rows = (chain.closure_rows, chain.K, chain.bias, chain.coordinates, chain.mode_indicators, chain.alignment)
        open_by, K, rate, own, modes, alignment = values(chain, rows, q=q, v=v)
        np.testing.assert_allclose(open_by, 0.0, atol=1e-9)
        np.testing.assert_allclose(K, state.K[0], atol=1e-9)
        np.testing.assert_allclose(rate[:, 0], bias, atol=1e-9 * (1.0 + np.abs(bias).max()))
        np.testing.assert_allclose(own[:, 0], x.ravel(), atol=1e-12)
        indicators = mode_indicator(robot, q[None])[0] * robot.working_mode if len(robot.working_mode) else np.empty(0)
        np.testing.assert_allclose(modes[:, 0], indicators, atol=1e-12)
        # what is missing to a pose nearby, and to one that is turned farther: the sine of the angle, about its axis
        far = rng.uniform(-0.4, 0.4, robot.n)
        target = moved(robot, x[None], far[None])[0]
        missing, alignment = values(chain, (chain.missing, chain.alignment), q=q, x=np.ravel(target))
        expected = difference(robot, target[None], x[None])[0]
        if chain.is_pose:
            turn = Rotation.from_matrix(target[:3, :3] @ x[:3, :3].T).as_rotvec()
            angle = np.linalg.norm(turn)
            expected[3:] = turn * np.sin(angle) / angle
            np.testing.assert_allclose(alignment[-1], np.cos(angle), atol=1e-12)
        np.testing.assert_allclose(missing[:, 0], expected, atol=1e-12)
        assert (alignment > 0.0).all()


def test_efforts_and_energy_of_the_tree_are_pinocchios(robot: rp.Robot) -> None:
    """Away from closures, carriers included; joint loads and springs have tests of their own."""
    chain, rng = SymbolicChain(robot), np.random.default_rng(8)
    model = robot.model.copy()
    data = model.createData()
    for _ in range(2):
        q = pin.integrate(model, np.array(robot.q_reference), rng.uniform(-0.5, 0.5, model.nv))
        v, a = rng.normal(size=(2, model.nv))
        efforts, energy = values(chain, (chain.efforts[0], chain.energy), q=q, v=v, a=a)
        expected = pin.rnea(model, data, q, v, a)
        np.testing.assert_allclose(efforts[:, 0], expected, atol=1e-9 * (1.0 + np.abs(expected).max()))
        # the force that holds the base is what the momentum of all changes by, less its weight
        (base,) = values(chain, (chain.efforts[1],), q=q, v=v, a=a)
        pin.computeCentroidalMomentumTimeVariation(model, data, q, v, a)
        np.testing.assert_allclose(base[:3, 0], data.dhg.linear - data.mass[0] * model.gravity.linear, atol=1e-8)
        kinetic = pin.computeKineticEnergy(model, data, q, v)
        np.testing.assert_allclose(energy, kinetic + pin.computePotentialEnergy(model, data, q), atol=1e-9)


def test_angles_have_their_cosines_and_sines_once(robot: rp.Robot) -> None:
    """Who evaluates many functions computes them once: of joints that turn, but carriers and continuous ones."""
    turning = [
        int(joint.idx_q)
        for joint in robot.model.joints[1:]
        if joint.nq == 1 and joint.shortname().startswith("JointModelR") and joint.idx_v not in robot.carrier_velocity
    ]
    assert SymbolicChain(robot).turning == turning


def test_a_pose_far_away_is_approached_in_equal_turns() -> None:
    """By the least rotation, and along a straight line; coordinates go at once."""
    first, last = np.eye(4), np.eye(4)
    turn, angle = np.array([1.0, 2.0, -2.0]) / 3.0, 3.5 * LARGEST_TURN
    first[:3, :3] = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix()
    last[:3, :3] = Rotation.from_rotvec(angle * turn).as_matrix() @ first[:3, :3]
    first[:3, 3], last[:3, 3] = [1.0, 2.0, 3.0], [0.0, 4.0, 3.5]
    way = np.array(waypoints(first.ravel(), last.ravel(), True)).reshape(-1, 4, 4)
    assert len(way) == 4
    for share, pose in zip((0.25, 0.5, 0.75, 1.0), way, strict=True):
        expected = Rotation.from_rotvec(share * angle * turn).as_matrix() @ first[:3, :3]
        np.testing.assert_allclose(pose[:3, :3], expected, atol=1e-12)
        np.testing.assert_allclose(pose[:3, 3], (1.0 - share) * first[:3, 3] + share * last[:3, 3], atol=1e-12)
        np.testing.assert_array_equal(pose[3], [0.0, 0.0, 0.0, 1.0])
    np.testing.assert_array_equal(way[-1], last)
    beside = first.copy()
    beside[:3, 3] += 1.0
    assert [pose.tolist() for pose in waypoints(first.ravel(), beside.ravel(), True)] == [beside.ravel().tolist()]
    assert waypoints(np.zeros(2), np.ones(2), False)[0].tolist() == [1.0, 1.0]


@pytest.mark.parametrize("name", ["3rrr", "gough"])
def test_columns_of_masses_are_what_pinocchios_inertias_change_by(name: str) -> None:
    """Mass, first moment and inertia about the origin: linear in a mass and in its inertia, by differences a centre."""
    robot = zoo.robot_of(name)
    joint = next(str(robot.model.names[i]) for i in range(1, robot.model.njoints) if robot.model.inertias[i].mass > 0.0)
    body = robot.model.inertias[robot.model.getJointId(joint)]
    mass, centre, inertia, h = body.mass, np.array(body.lever), np.eye(3), 1e-6  # any inertia will do

    def moments(m: float, c: Array, about: Array) -> Array:
        """By the spatial inertia: its lower right block is about the origin."""
        whole = pin.Inertia(m, c, about).matrix()
        first = np.array([whole[5, 1], whole[3, 2], whole[4, 0]])
        return np.concatenate([[m], first, whole[[3, 3, 4, 3, 4, 5], [3, 4, 4, 5, 5, 5]]])

    changes = {f"{joint}.mass": lambda d: (mass + d, centre, inertia)}
    for i, axis in enumerate("xyz"):
        changes[f"{joint}.centre.{axis}"] = lambda d, i=i: (mass, centre + d * np.eye(3)[i], inertia)
        for j in range(i, 3):
            change = np.zeros((3, 3))
            change[i, j] = change[j, i] = 1.0
            changes[f"{joint}.inertia.{axis}{'xyz'[j]}"] = lambda d, c=change: (mass, centre, inertia + d * c)
    for parameter, changed in changes.items():
        column = design.by_model(robot, parameter)
        expected = (moments(*changed(h)) - moments(*changed(-h))) / (2.0 * h)
        at = places_of(robot)["joint", robot.model.getJointId(joint), "body"]
        np.testing.assert_allclose(column[at], expected, atol=1e-8)
        assert np.count_nonzero(column) == np.count_nonzero(column[at])


def test_frames_of_all_corners_are_the_other_backends() -> None:
    """Pushed at each link of the 3-RRR by itself."""
    robot, t = zoo.robot_of("3rrr"), np.linspace(0.0, 1.0, 5)
    motion, carriers = zoo.smooth_motion(robot, 3).at(t), zoo.carriers_at(robot, t)
    links = [name for closure in robot.closures for name in (closure.frame_a, closure.frame_b)]
    for link in dict.fromkeys(links):
        push = [rp.Wrench(link, [3.0, -2.0, 0.0, 0.0, 0.0, 1.5], "local", (0.1, 0.2, 0.0))]
        ours, theirs = (
            backend(robot).reduce(motion, carriers, external=push).f for backend in (rp.VirtualWork, rp.RneaDynamics)
        )
        np.testing.assert_allclose(ours, theirs, atol=1e-10)


@pytest.mark.parametrize(
    ("samples", "threads", "count"),
    [(0, 4, 1), (1, 4, 1), (799, 4, 1), (800, 4, 2), (1199, 4, 2), (1200, 4, 3), (4001, 4, 4), (4001, 1, 1)],
)
def test_samples_are_shared_out_evenly_from_four_hundred_a_thread_on(samples: int, threads: int, count: int) -> None:
    parts = parts_of(samples, threads)
    assert len(parts) == count
    assert [k for part in parts for k in range(samples)[part]] == list(range(samples))
    sizes = [part.stop - part.start for part in parts]
    assert max(sizes) - min(sizes) <= 1


def test_expressions_of_the_carriers_motion_have_the_values_of_rnea(shipped: rp.Robot) -> None:
    """Of many samples at once, each with its own influence matrix."""
    t = np.linspace(0.0, 1.0, 4)
    motion, carriers = zoo.smooth_motion(shipped, 5).at(t), zoo.carriers_at(shipped, t)
    along = rp.CompiledDynamics(shipped).along(motion)
    f, force = along.expressions(*(ca.DM(part.T) for part in (carriers.s, carriers.sd, carriers.sdd)))
    wanted = rp.RneaDynamics(shipped).reduce(motion, carriers)
    for got, want in ((f, wanted.f), (force, wanted.carrier_force)):
        np.testing.assert_allclose(np.array(got).T, want, rtol=1e-9, atol=1e-9 * np.abs(wanted.f).max())
