"""Least peak in the coefficients of splines: courses, efforts and their slopes, and plans against IPOPT's own."""

import numpy as np
import pytest
import zoo
from scipy.interpolate import BPoly

import redundancy_pin.planners.whole_trajectory.least_peak as method
import redundancy_pin.planners.whole_trajectory.solver as solver
from redundancy_pin import CarrierMotion, RneaDynamics, VirtualWork, distribute, load_robot, plan_whole_trajectory
from redundancy_pin.planners.carrier_model import Actuation, CarrierModel, carrier_model, turning_model
from redundancy_pin.planners.whole_trajectory.least_peak import least_peak, serves
from redundancy_pin.planners.whole_trajectory.options import Limits, Mesh, Objective, checked_settings
from redundancy_pin.planners.whole_trajectory.problem import Task, grid_of, read_coefficients, with_middles
from redundancy_pin.planners.whole_trajectory.splines import EffortsAlong, Inequalities, Loads, Splines
from redundancy_pin.planners.whole_trajectory.transcription import REGULARISATION, scaled_bounds
from redundancy_pin.trajectory import reference
from redundancy_pin.trajectory.continuous_motion import continuous_motion
from redundancy_pin.trajectory.functions_of_time import carriers_at

CIRCLE = reference.circle(0.5, 0.2, 0.05)
SAME = 1e-7
"""Relative difference of the peaks of two ways to one optimum; found are 1e-9 and less."""

MENDED = 1e-9
"""Of a step, which refinement brings back from 1e-2."""


@pytest.fixture(scope="module")
def arms():
    """The 2-RPR with carriers on turning arms."""
    return load_robot("2rpr", arm_length=0.15, end_effector_mass=0.5, cylinder_mass=0.3)


def problem_of(dynamics, trajectory, dt=0.05, turning=False, objective="peak", middles=True, limits=None, **settings):
    robot, source = dynamics.robot, continuous_motion(trajectory)
    checked = checked_settings(robot, Objective(objective), limits or Limits(), Mesh(dt, 0), **settings)
    instants = Actuation.along(dynamics, source).singular_instants
    grid = grid_of(source, instants, dt)
    if middles:
        steps = np.zeros(len(grid.h), dtype=bool)
        steps[3:9] = True
        grid = with_middles(grid, steps)
    return read_coefficients(Task(dynamics, source, checked), grid, turning=turning)


@pytest.fixture(scope="module")
def crossing(arms):
    """Turning carriers through singular instants, jumps of the acceleration and middle nodes."""
    problem = problem_of(RneaDynamics(arms), CIRCLE, turning=True)
    assert len(problem.singular) == 2
    assert problem.grid.smooth.sum() > 6
    return problem


def test_a_singular_instant_next_to_a_kink_is_one_node_with_it():
    source = continuous_motion(CIRCLE)
    kink = sorted(source.kinks)[len(source.kinks) // 2]
    grid = grid_of(source, [kink + 1e-12 * (source.end - source.start)], 0.05)
    assert len(grid.singular) in (1, 2)  # two where the acceleration jumps
    assert grid.h[grid.h > 0.0].min() > 1e-3


@pytest.mark.parametrize("end", ["datum", "rest", "free"])
def test_any_coefficients_are_a_course_of_the_transcription(end):
    settings = {"start": 0.05, "start_speed": 0.3, "end": end}
    problem = problem_of(VirtualWork(zoo.robot_of("2rpr")), CIRCLE, **settings)
    splines, grid, size = Splines(problem), problem.grid, problem.scales
    y = splines.course(np.random.default_rng(0).normal(size=splines.count))
    s, sd, sdd = (y[..., i] * getattr(size, name) for i, name in enumerate(("s", "sd", "sdd")))
    h = grid.h[:, None]
    np.testing.assert_allclose(np.diff(s, axis=0), h * sd[:-1] + h**2 / 6.0 * (2.0 * sdd[:-1] + sdd[1:]), atol=1e-12)
    rounding = 1e-12 * np.abs(sd).max()
    np.testing.assert_allclose(np.diff(sd, axis=0), h / 2.0 * (sdd[:-1] + sdd[1:]), atol=rounding)
    at, steps = np.flatnonzero(grid.smooth), np.flatnonzero(grid.h > 0.0)
    jerk = np.zeros((len(grid.h), 2))
    jerk[steps] = np.diff(sdd, axis=0)[steps] / h[steps]
    largest = np.abs(jerk).max()
    np.testing.assert_allclose(jerk[at], jerk[at - 1], atol=1e-9 * largest)
    np.testing.assert_allclose(y[at, :, 3] * size.sdd, jerk[at], atol=1e-9 * largest)
    np.testing.assert_allclose([s[0], sd[0]], [[0.05] * 2, [0.3] * 2], rtol=1e-12)
    if end != "free":
        np.testing.assert_allclose(sd[-1], 0.0, atol=rounding)
    if end == "datum":
        np.testing.assert_allclose(s[-1], 0.0, atol=1e-12)
    # nothing is missing: a knot at each node that is neither smooth nor an end, and a cubic, less what is fixed
    fixed = {"datum": 4, "rest": 3, "free": 2}[end]
    assert splines.count == 2 * (len(grid.t) - 2 - len(at) + 4 - fixed)
    np.testing.assert_allclose(splines.course(splines.fitted(y[..., :3])), y, atol=1e-7 * np.abs(y).max())


@pytest.mark.parametrize("turning", [False, True])
def test_loads_and_their_derivatives(arms, turning):
    robot = arms if turning else zoo.robot_of("2rpr")
    along = RneaDynamics(robot).along(CIRCLE.sample(0.4))
    model = (turning_model if turning else carrier_model)(along)
    motion = np.random.default_rng(2).normal(size=(len(model.t), 2, 3)) * [0.4, 3.0, 30.0]
    value, first, second = Loads(model)(motion)
    true = along.reduce(CarrierMotion(*np.moveaxis(motion, -1, 0)))
    np.testing.assert_allclose(value, true.f, atol=1e-10 * np.abs(true.f).max())
    for q, step in enumerate((1e-5, 1e-4, 1e-3)):
        for k in range(2):
            move = np.zeros_like(motion)
            move[:, k, q] = step
            ahead, behind = Loads(model)(motion + move), Loads(model)(motion - move)
            for order, exact in ((0, first[:, :, k, q]), (1, second[:, :, k, :, q])):
                difference = (ahead[order] - behind[order]) / (2.0 * step)
                if order:
                    difference = difference[:, :, k]
                atol = 1e-6 * np.abs(exact).max() + 1e-9 * np.abs(ahead[order]).max() / step * 1e-3
                np.testing.assert_allclose(difference, exact, atol=atol)


def test_efforts_are_those_of_the_backend_and_their_slopes_right_through_singular_instants(crossing, arms):
    splines = Splines(crossing)
    efforts = EffortsAlong(crossing, splines.size)
    rng = np.random.default_rng(1)
    y = splines.course(0.1 * rng.normal(size=splines.count))
    at = efforts(y)
    u, t = crossing.scales, crossing.grid.t
    source = continuous_motion(CIRCLE)
    carriers = CarrierMotion(y[..., 0] * u.s, y[..., 1] * u.sd, y[..., 2] * u.sdd)
    reduced = RneaDynamics(arms).reduce(source.sample_at(t), carriers)
    # a random course leaves the range of W at the singular instants
    far = np.setdiff1d(np.arange(len(t)), crossing.grid.singular)
    tau = distribute(reduced).tau
    np.testing.assert_allclose(at.tau[far] * u.tau, tau[far], rtol=1e-8, atol=1e-8 * np.abs(tau[far]).max())
    lost = np.concatenate([node.lost for node in crossing.singular])
    missed = np.einsum("rn,rn->r", lost, reduced.f[efforts.at]) / (np.abs(lost) @ u.row)
    assert np.abs(missed).min() > 1e-4
    np.testing.assert_allclose(at.e, missed, rtol=1e-6)
    change = rng.normal(size=splines.count)
    ahead, behind = (efforts(splines.course(0.0 * change + x)) for x in _beside(splines, y, change, 1e-6))
    dy = (splines.matrix @ change).reshape(y.shape)
    exact = np.einsum("mikq,mkq->mi", at.slopes, dy)
    np.testing.assert_allclose((ahead.tau - behind.tau) / 2e-6, exact, rtol=1e-5, atol=1e-7 * np.abs(exact).max())
    by_e = np.einsum("rkq,rkq->r", at.by_y, dy[efforts.at])
    np.testing.assert_allclose((ahead.e - behind.e) / 2e-6, by_e, rtol=1e-5)


def test_efforts_at_singular_instants_have_the_rate_that_the_load_has_there(crossing, arms):
    """uᵀ Ẇ τ = uᵀ ḟ along the course, by differences of the backend in time; W τ = f across u as elsewhere."""
    splines = Splines(crossing)
    y = splines.course(0.1 * np.random.default_rng(5).normal(size=splines.count))
    tau = EffortsAlong(crossing, splines.size)(y).tau * crossing.scales.tau
    position = crossing.position({name: y[..., i] for i, name in enumerate(("s", "sd", "sdd"))})
    source, h = continuous_motion(CIRCLE), 1e-5
    for node in crossing.singular:
        times = crossing.grid.t[node.index] + h * np.arange(-1.0, 2.0)
        reduced = RneaDynamics(arms).reduce(source.sample_at(times), carriers_at(position, times))
        W_rate, f_rate = ((part[2] - part[0]) / (2.0 * h) for part in (np.asarray(reduced.W), np.asarray(reduced.f)))
        rate = node.lost @ f_rate
        np.testing.assert_allclose(node.lost @ W_rate @ tau[node.index], rate, atol=1e-6 * np.abs(f_rate).max())
        assert np.abs(rate).min() > 1e-3 * np.abs(f_rate).max()  # else the first line says nothing
        across = np.linalg.svd(node.lost)[2][len(node.lost) :]
        left = across @ (reduced.W[1] @ tau[node.index] - reduced.f[1])
        np.testing.assert_allclose(left, 0.0, atol=1e-8 * np.abs(reduced.f[1]).max())


def _beside(splines, y, change, step):
    x = splines.fitted(y[..., :3])
    return x + step * change, x - step * change


def test_limits_between_the_nodes_hold_the_inner_control_points():
    problem = problem_of(VirtualWork(zoo.robot_of("2rpr")), CIRCLE, end="free", limits=Limits(acceleration=np.inf))
    splines, steps = Splines(problem), problem.grid.h > 0.0
    x = np.random.default_rng(3).normal(size=splines.count)
    y = splines.course(x)
    g = Inequalities(problem, splines, steps)(x, 0.0, np.zeros((len(y), 2)))[4 * len(y) :]
    position, u = problem.position({name: y[..., i] for i, name in enumerate(("s", "sd", "sdd"))}), problem.scales
    inner = [
        BPoly.from_power_basis(function.ppoly).c[1:-1] / size
        for function, size in ((position, u.s), (position.derivative(), u.sd))
    ]
    bounds = scaled_bounds(problem)
    expected = []
    for side, sign in ((0, 1.0), (1, -1.0)):
        for i, name in enumerate(("s", "sd")):
            # the first node's are given
            values = np.concatenate([y[1:, :, i].ravel(), inner[i].ravel()]).reshape(-1, 2)
            expected.append(sign * (values - bounds[name][side]).ravel())
    np.testing.assert_allclose(np.sort(g), np.sort(np.concatenate(expected)), rtol=1e-7, atol=1e-9)


def without(monkeypatch):
    """Leave planning to IPOPT."""
    monkeypatch.setattr(solver, "serves", lambda problem: False)


@pytest.mark.long_for("sliding", "turning", "through", "rest", "free")
@pytest.mark.parametrize("case", ["sliding", "turning", "through", "rest", "free", "speeds"])
def test_plans_are_those_of_ipopt_alone(arms, case, monkeypatch):
    turning = case == "turning"
    dynamics = RneaDynamics(arms) if turning else VirtualWork(zoo.robot_of("3rrr" if case == "sliding" else "2rpr"))
    trajectory = {"sliding": reference.corner(0.025), "turning": reference.line(0.5, 0.2)}.get(case, CIRCLE)
    settings = {"dt": 0.05, "refinements": 0, "objective": "peak"}
    settings |= {"end": case} if case in ("rest", "free") else {}
    settings |= {"speed": 0.3, "start": 0.05, "start_speed": 0.1} if case == "speeds" else {}
    used = []

    def counted(*given):
        used.append(least_peak(*given))
        return used[-1]

    monkeypatch.setattr(solver, "least_peak", counted)
    ours = plan_whole_trajectory(dynamics, trajectory, **settings)
    assert used
    assert None not in used
    without(monkeypatch)
    theirs = plan_whole_trajectory(dynamics, trajectory, **settings)
    assert ours.status is theirs.status
    assert ours.diagnostics["optimal"]
    np.testing.assert_allclose(
        ours.diagnostics["objective"]["peak"], theirs.diagnostics["objective"]["peak"], rtol=SAME
    )
    # rows between the nodes may be those of other steps, and then efforts of a flat optimum are a little others
    apart = {"speeds": 1e-3, "turning": 1e-4}.get(case, 1e-6)
    np.testing.assert_allclose(ours.tau, theirs.tau, atol=apart * np.abs(theirs.tau).max())
    # it was near before IPOPT had a look: within its own promise
    np.testing.assert_allclose(used[-1].cost, ours.diagnostics["cost"], rtol=1e-5)


def test_where_it_ends_without_an_optimum_the_plan_is_ipopts(monkeypatch):
    dynamics, settings = VirtualWork(zoo.robot_of("2rpr")), {"dt": 0.05, "refinements": 0, "objective": "peak"}
    monkeypatch.setattr(solver, "least_peak", lambda *given: None)
    ours = plan_whole_trajectory(dynamics, CIRCLE, **settings)
    without(monkeypatch)
    theirs = plan_whole_trajectory(dynamics, CIRCLE, **settings)
    np.testing.assert_array_equal(ours.tau, theirs.tau)


def test_what_it_serves():
    dynamics = VirtualWork(zoo.robot_of("2rpr"))

    def served(**settings):
        return serves(problem_of(dynamics, CIRCLE, dt=0.3, middles=False, **settings))

    assert served()
    assert not served(objective={"peak": 1.0, "effort": 1.0})
    assert not served(at_most={"energy": 9.0})
    assert not served(end="periodic")
    assert not served(limits=Limits(jerk=900.0))
    assert not served(limits=Limits(effort=(9.0, np.inf)))


def test_progress_and_the_time_bound_end_it(monkeypatch):
    dynamics, settings = VirtualWork(zoo.robot_of("2rpr")), {"dt": 0.05, "refinements": 0, "objective": "peak"}
    monkeypatch.setattr(solver, "LONG", 1)

    def stop(line):
        if line.startswith("iteration"):
            raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        plan_whole_trajectory(dynamics, CIRCLE, progress=stop, **settings)
    problem = problem_of(dynamics, CIRCLE)
    asked = []

    def two(iteration, cost):
        asked.append(iteration)
        return iteration < 2

    assert least_peak(problem, {}, np.zeros(len(problem.grid.h), dtype=bool), two) is None
    assert asked == [0, 1, 2]


@pytest.mark.parametrize(
    ("limits", "settings", "let_out"),
    [
        (Limits(track=[0.0, 0.3]), {"end": "datum"}, "lower s"),
        (Limits(track=[-0.3, 0.0]), {"end": "datum"}, "upper s"),
        (Limits(track=[-0.3, 0.3]), {"start": 0.3, "end": "rest"}, "upper s"),
        (Limits(track=[-0.3, 0.3], speed=0.2), {"start_speed": 0.2, "end": "rest"}, "lower sd, upper sd"),
        (Limits(track=[-0.3, 0.3], speed=0.2), {"start_speed": -0.1, "end": "rest"}, ""),
    ],
)
def test_limits_on_which_carriers_start_or_end_are_let_out_a_little_and_no_others(limits, settings, let_out):
    """The solver needs an interior there; all others are kept with something to spare for rounding."""
    problem = problem_of(VirtualWork(zoo.robot_of("2rpr")), CIRCLE, limits=limits, **settings)
    own, sizes = problem.settings.limits, problem.scales
    for name, size, ends in (("s", sizes.s, own.track.T), ("sd", sizes.sd, (-own.speed, own.speed))):
        width = ends[1] - ends[0]
        bounds = (bound * size for bound in scaled_bounds(problem)[name])
        for side, sign, end, bound in zip(("lower", "upper"), (-1.0, 1.0), ends, bounds, strict=True):
            beyond = sign * (bound - end) / width
            if not np.isfinite(width).all():
                assert name == "sd"
            elif f"{side} {name}" in let_out.split(", "):
                assert (beyond > 1e-11).all()
                assert (beyond < 1e-9).all()
            else:
                assert (beyond > -2e-9).all()
                assert (beyond < -1e-11).all()


@pytest.fixture(scope="module")
def systems():
    """Newton's equations at each iteration: no singular instants, limits that bind between nodes."""
    dynamics, seen = VirtualWork(zoo.robot_of("3rrr")), []
    problem = problem_of(dynamics, reference.corner(0.025), limits=Limits(speed=0.02))
    with pytest.MonkeyPatch.context() as patch:

        class Noted(method.NewtonSystem):
            def __init__(self, *given):
                super().__init__(*given)
                seen.append((self, given))

        patch.setattr(method, "NewtonSystem", Noted)
        between = problem.grid.h > 0.0
        found = least_peak(problem, {}, between, lambda iteration, cost: True)
    assert found is not None
    return problem, found, seen


def test_a_step_solves_the_equations_linearised(systems):
    """By differences of residuals, which are put together anew at both ends of a part of the step."""
    _, found, seen = systems
    for system, (efforts, limits, gentle, _, y, left, w, z, nu) in seen[3 : found.iterations : 4]:
        splines, mu = limits.splines, float(w @ z) / len(w)
        assert system.factorise()
        solution, dw, dz = system.step(mu, mu)
        np.testing.assert_allclose(w * z + z * dw + w * dz, mu, rtol=1e-9)
        n, h = splines.count, 1e-4
        x, p = splines.fitted(y[..., :3]), float((left + w)[0] + efforts(y).tau.ravel()[0])
        ends = []
        for part in (h, -h):
            beside = splines.course(x + part * solution[:n])
            at, peak = efforts(beside), p + part * solution[n]
            g = limits(x + part * solution[:n], peak, at.tau)
            ends.append(method.NewtonSystem(efforts, limits, gentle, at, beside, g - w, w, z + part * dz, nu))
        by_step = (ends[0].left - ends[1].left) / (2.0 * h)
        np.testing.assert_allclose(by_step - dw, -left, atol=1e-6 * np.abs(dw).max())
        by_step = (ends[0].dual - ends[1].dual) / (2.0 * h)
        terms = np.abs(system.back.multiply(dz)).sum(axis=1).max()
        np.testing.assert_allclose(by_step, -system.dual, atol=1e-6 * terms)


def test_a_step_is_the_same_with_factors_that_are_a_little_off(systems, monkeypatch):
    """Refinement makes it good, as it does rounding: by a hundredth here, differently in each unknown."""
    _, found, seen = systems
    rough = method.NewtonSystem.rough
    for system, given in seen[2 : found.iterations : 4]:
        w, z = given[6:8]
        mu = float(w @ z) / len(w)
        assert system.factorise()
        exact = system.step(mu, mu)[0]
        off = 1.0 + 0.01 * np.sin(np.arange(len(exact)))
        with monkeypatch.context() as patch:
            patch.setattr(method.NewtonSystem, "rough", lambda self, right, off=off: off * rough(self, right))
            mended = system.step(mu, mu)[0]
        # ten refinements of a hundredth each; without any the steps would be a hundredth apart
        np.testing.assert_allclose(mended, exact, atol=MENDED * np.abs(exact).max())


def test_the_residual_is_the_gradient_of_the_lagrangian(systems):
    """Of peak and regularisation less z g: by differences of its value."""
    problem, found, seen = systems
    rng = np.random.default_rng(4)
    for system, (efforts, limits, _, _, y, left, w, z, _) in seen[2 : found.iterations : 5]:
        splines = limits.splines
        x, p = splines.fitted(y[..., :3]), float((left + w)[0] + efforts(y).tau.ravel()[0])

        def lagrangian(x, p, efforts=efforts, limits=limits, z=z):
            y = limits.splines.course(x)
            squares = (y[..., 2] ** 2).sum(axis=1)
            mean = np.trapezoid(squares, problem.grid.t) / problem.scales.duration
            return p + REGULARISATION * mean - z @ limits(x, p, efforts(y).tau)

        dx, dp, h = rng.normal(size=splines.count), rng.normal(), 1e-5
        change = (lagrangian(x + h * dx, p + h * dp) - lagrangian(x - h * dx, p - h * dp)) / (2.0 * h)
        np.testing.assert_allclose(system.dual @ np.append(dx, dp), change, atol=1e-6 * np.abs(dx).max())


def test_few_iterations_and_refinements_are_enough(systems, monkeypatch):
    """What predictor, correctors and factors are for: an optimum without them is the same, and takes longer."""
    problem, found, _ = systems
    rounds = []
    rough = method.NewtonSystem.rough
    monkeypatch.setattr(method.NewtonSystem, "rough", lambda self, right: rounds.append(self) or rough(self, right))
    least_peak(problem, {}, problem.grid.h > 0.0, lambda iteration, cost: True)
    # 12 iterations of a predictor, a corrector, up to two more and a refinement, 42 in all; one more by rounding
    assert found.iterations <= 13
    assert len(rounds) <= 46
    np.testing.assert_allclose(np.abs(found.values["sd"]).max(axis=0) * problem.scales.sd, 0.02, rtol=1e-4)


@pytest.mark.parametrize("terms", [5, 7, 23])
def test_loads_and_their_derivatives_are_those_of_the_terms(terms):
    """Of straight tracks, of a fit to second order, and of carriers that turn: against differences of the model."""
    count, n, k = 4, 2, 3
    rng = np.random.default_rng(terms)
    W, f0, force = rng.normal(size=(count, n, 2)), rng.normal(size=(count, n)), np.zeros((count, k))
    model = CarrierModel(np.arange(4.0), W, f0, rng.normal(size=(count, n, k, terms)), force, np.zeros((4, k, terms)))
    at = rng.normal(size=(count, k, 3))
    f, first, second = Loads(model)(at)
    np.testing.assert_allclose(f, model.f(*np.moveaxis(at, -1, 0)), rtol=1e-13, atol=1e-13)
    step = 1e-5  # differences off by its square, and rounding over it
    for j in range(k):
        for a in range(3):
            moved = np.zeros_like(at)
            moved[:, j, a] = step
            (more, more_first, _), (less, less_first, _) = Loads(model)(at + moved), Loads(model)(at - moved)
            np.testing.assert_allclose(first[:, :, j, a], (more - less) / (2.0 * step), atol=1e-7)
            rates = (more_first - less_first)[:, :, j] / (2.0 * step)
            np.testing.assert_allclose(second[:, :, j, a], rates, atol=1e-7)
