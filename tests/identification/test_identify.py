"""Parameters from measured motions: against machines whose parameters are known."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import zoo
from engines import drive_of_motion, run_exudyn, run_mujoco
from measured import built, declared, measured, noisy, true_values
from scipy.stats import norm

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.rnea import RneaAlongMotion
from redundancy_pin.identification import Fit, Records, identify, parameters_of, physical
from redundancy_pin.identification.equations import linearise, measure
from redundancy_pin.identification.parameters import INERTIAL, tilted, with_values
from redundancy_pin.identification.physical import nearest_physical
from redundancy_pin.identification.records import smooth_motion
from redundancy_pin.robot import Robot
from redundancy_pin.status import ResultStatus

Z95 = float(norm.ppf(0.975))

CUT_OFF = 12.0
"""Hz: the motions have parts up to 1.3 Hz, and their products a few times that."""


def relative_error(found: Array, true: Array) -> float:
    return float(np.linalg.norm(found - true) / np.linalg.norm(true - true.mean(axis=0)))


def prediction(fit: Fit, robot: Robot, seed: int) -> float:
    """Return the error of f by a fit on a motion that it has not seen, relative to the size of f."""
    t = np.linspace(0.0, 3.0, 60)
    motion, carriers = zoo.smooth_motion(robot, seed=seed, speed=8.0).at(t), zoo.carriers_at(robot, t, seed)
    return relative_error(*(rp.RneaDynamics(one).reduce(motion, carriers).f for one in (fit.robot, robot)))


def deviations(fit: Fit, true: Robot) -> Array:
    """Return (b,) errors of the estimates in their standard deviations."""
    result: Array = (fit.values - true_values(fit, true)) / fit.standard_deviation
    return result


@pytest.mark.parametrize("name", ["five_bar", "delta", "gough", "3rrr"])
def test_a_machine_with_noise_is_found_within_its_intervals(name: str) -> None:
    given = declared(name)
    true = built(given)
    fit = identify(given, noisy(measured(rp.RneaDynamics(true)), seed=1), cut_off=CUT_OFF)
    off = deviations(fit, true)
    assert fit.status is ResultStatus.OK
    assert np.abs(off).max() < 4.0
    assert 0.6 < np.sqrt((off**2).mean()) < 1.5
    assert np.abs(fit.whiteness).max() < 4.0 / np.sqrt(len(fit.t))
    assert prediction(fit, true, seed=9) < (0.02 if name == "gough" else 0.01)  # of 94 parameters
    assert prediction(replace(fit, parameters_after=np.array([p.value for p in fit.base.parameters])), true, 9) > 0.05


@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
def test_virtual_work_of_other_masses_is_found(name: str) -> None:
    """Efforts come from closed forms that share nothing with the regressor, carriers included."""
    arguments = {"2rpr": {"end_effector_mass": 0.9, "carrier_mass": 1.7}, "3rrr": {"carrier_mass": 1.7}}[name]
    given, true = zoo.robot_of(name), zoo.robot_of(name, **arguments)
    fit = identify(given, measured(rp.VirtualWork(true)), cut_off=25.0, parameters=["mass *", "moment *", "inertia *"])
    true_ones = true_values(fit, true)
    assert np.abs(fit.values - true_ones).max() < 1e-5 * np.abs(true_ones).max()
    assert prediction(fit, true, seed=9) < 1e-6


@pytest.mark.parametrize("engine", ["mujoco", "exudyn"])
def test_a_machine_in_another_engine_is_found(engine: str) -> None:
    """Five per cent of noise, encoder steps, and motions that no code of ours has integrated."""
    pytest.importorskip(engine)
    given = zoo.robot_of("five_bar", carriers=False)
    true = built(given)
    t = np.linspace(0.0, 3.0, 301)
    drive = drive_of_motion(rp.RneaDynamics(true), zoo.smooth_motion(true, seed=2, speed=8.0).at(t))
    run = (run_mujoco if engine == "mujoco" else run_exudyn)(drive.task, step=1e-3)
    efforts = drive.task.efforts(run.t)[:, : given.m]
    exact = Records(run.t, efforts, given.joint_positions(run.q))
    fit = identify(given, noisy(exact, seed=4), cut_off=CUT_OFF, parameters=["mass of *", "moment*", "inertia*"])
    off = (fit.values - true_values(fit, true)) / fit.standard_deviation
    assert np.abs(off).max() < 4.0
    assert prediction(fit, true, seed=9) < 0.02


def coverage(draws: int, name: str = "five_bar", seconds: float = 2.5) -> Array:
    """Return (draws, b) whether intervals hold the truth: one simulation, noise and counts anew."""
    given = declared(name)
    true = built(given)
    exact = measured(rp.RneaDynamics(true), seconds=seconds, rate=200.0)
    return np.array([np.abs(deviations(fit, true)) < Z95 for fit in drawn(given, exact, draws)])


def drawn(given: Robot, exact: Records, draws: int) -> Iterator[Fit]:
    for seed in range(draws):
        yield identify(given, noisy(exact, seed=seed), cut_off=CUT_OFF)


def test_intervals_hold_the_truth_about_as_often_as_they_say() -> None:
    assert abs(coverage(16).mean() - 0.95) < 0.02


@pytest.mark.long
def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """Bounds by the scatter of 400 draws: pooled 95 ± 1 % and 2 standard errors, each one within 3.5 of the pooled."""
    inside = coverage(400)
    pooled, error = float(inside.mean()), float(inside.mean(axis=1).std() / np.sqrt(len(inside)))
    assert error < 0.004
    assert abs(pooled - 0.95) < 0.01 + 2.0 * error
    assert np.abs(inside.mean(axis=0) - pooled).max() < 3.5 * np.sqrt(pooled * (1.0 - pooled) / len(inside))


@pytest.mark.long
def test_intervals_of_many_parameters_hold_the_truth_as_often_as_they_say() -> None:
    """Of a Gough platform; intervals of one draw are correlated, the standard error of 60 draws is 0.5 %."""
    assert abs(coverage(60, "gough", seconds=6.0).mean() - 0.95) < 0.02


def test_noise_of_rates_reaches_f_as_its_derivative() -> None:
    """Coriolis forces, friction and masses: the noise that intervals allow for, by finite differences of RNEA."""
    robot = built(declared("3rrr"))
    robot = robot.loaded(rp.JointForces(robot.carriers[0], rotor_inertia=0.01, gear=5.0)) if not robot.loads else robot
    records, chosen = measured(rp.RneaDynamics(robot), seconds=2.0, speed=20.0), parameters_of(robot)
    record = measure(robot, records, smooth_motion(robot, records, 20.0), carried=True)
    values = np.array([p.value for p in chosen])
    found = linearise(record, chosen, values, [0]).by_rates
    tree = record.along.tree_motion(record.smooth.carriers)

    def f(rate: Array, acceleration: Array) -> Array:
        moved = replace(record.along.tree, v=tree[1] + rate, a=tree[2] + acceleration)
        along = RneaAlongMotion(moved)
        effort = along.tree_effort(along_carriers(tree, rate, acceleration))
        return np.einsum("Nvr,Nv->Nr", record.projection, effort)

    def along_carriers(tree: tuple[Array, Array, Array], rate: Array, acceleration: Array) -> rp.CarrierMotion:
        own = robot.carrier_velocity
        s = tree[0][:, robot.carrier_position]
        return rp.CarrierMotion(s, (tree[1] + rate)[:, own], (tree[2] + acceleration)[:, own], check_rates=False)

    for j in range(record.per_rate.shape[2]):
        way, still, h = record.per_rate[:, :, j], np.zeros(tree[1].shape), 1e-5
        for by, (rate, acceleration) in zip(found, ((h * way, still), (still, h * way)), strict=True):
            difference = (f(rate, acceleration) - f(-rate, -acceleration)) / (2.0 * h)
            assert np.abs(by[:, :, j] - difference).max() < 1e-4 * np.abs(difference).max()


# --- a five-bar, seconds of milliseconds -----------------------------------------------------------------------------


FIVE_BAR = zoo.robot_of("five_bar", carriers=False)


@lru_cache
def of_five_bar(effort: float = 0.05, counts: float = 2.0**17, seed: int = 1) -> tuple[Robot, Records]:
    """Return the machine that was built, with friction in its motors, and records of it."""
    given = declared_without_carriers()
    true = built(given)
    return true, noisy(measured(rp.RneaDynamics(true), seconds=4.0), seed, effort, counts)


@lru_cache
def declared_without_carriers() -> Robot:
    return FIVE_BAR.loaded(*(rp.JointForces(joint, friction_speed=0.02) for joint in FIVE_BAR.actuated))


def fit_of(records: Records | list[Records], **arguments: Any) -> Fit:
    return identify(declared_without_carriers(), records, **{"cut_off": CUT_OFF, **arguments})


def with_efforts(records: Records, effort: Array) -> Records:
    return Records(records.t, effort, records.position)


@pytest.mark.parametrize(("bits", "cut_off"), [(16.0, 12.0), (13.0, 12.0), (13.0, 30.0)])
def test_noise_of_positions_widens_the_intervals(bits: float, cut_off: float) -> None:
    """At 13 bits and 30 Hz accelerations have more noise than size: least squares alone errs by tens of per cent."""
    off = []
    for seed in range(4):
        true, records = of_five_bar(counts=2.0**bits, seed=seed)
        fit = fit_of(records, cut_off=cut_off)
        assert not fit.problems
        assert fit.status is ResultStatus.OK
        assert np.allclose(fit.position_noise, 2.0 * np.pi / 2.0**bits / np.sqrt(12.0), rtol=0.15)
        off.append(deviations(fit, true))
    assert 0.75 < np.sqrt(np.mean(np.square(off))) < 1.3
    assert np.abs(off).max() < 4.0


def test_a_fit_holds_what_it_says() -> None:
    true, records = of_five_bar()
    fit = fit_of(records)
    exact = measured(rp.RneaDynamics(true), seconds=4.0)
    kept = np.isin(records.t, fit.t)
    motion = zoo.smooth_motion(true, seed=0, speed=8.0).at(records.t)
    reduced = rp.RneaDynamics(true).reduce(motion)
    driven = np.einsum("Nij,Nj->Ni", reduced.W, records.effort)[kept]
    assert relative_error(fit.measured, driven) < 1e-3
    assert relative_error(fit.predicted, reduced.f[kept]) < 0.01
    assert np.allclose(fit.effort_noise, 0.05 * exact.effort.std(axis=0), rtol=0.1)
    std = np.sqrt(np.diagonal(fit.covariance))
    assert np.allclose(fit.standard_deviation, std)
    assert np.allclose(fit.intervals.T, [fit.values - Z95 * std, fit.values + Z95 * std], rtol=1e-9, atol=1e-6 * std)
    assert np.allclose(np.diagonal(fit.correlation), 1.0)
    assert np.allclose(fit.correlation * np.outer(std, std), fit.covariance)
    assert not fit.problems
    assert set(fit.base.units) == {"kg·m²", "kg·m", "N·m·s", "N·m"}
    text, facts = str(fit.summary()), fit.summary()
    for value, half, unit in zip(fit.values, Z95 * std, fit.base.units, strict=True):
        assert f" {value:.5g} ± {half:.2g} {unit} " in text  # names of many terms are wrapped, numbers are not
    assert facts["names"] == list(fit.base.names)
    assert np.allclose(facts["half_intervals"], Z95 * std)
    assert repr(fit) == f"Fit(five_bar: ok, {len(fit.t)} samples, 11 base parameters, 0 problems)"
    # whitened residuals of filtered noise are not white, and the fit says so
    noise = records.effort - exact.effort
    slow = np.apply_along_axis(np.convolve, 0, noise, np.full(4, 0.5), "same")
    filtered = fit_of(with_efforts(records, exact.effort + slow))
    assert 0.6 < filtered.whiteness.min() <= filtered.whiteness.max() < 0.85
    assert "correlated from sample to sample by up to 0." in filtered.problems[0]


@pytest.mark.parametrize(
    ("arguments", "cause"),
    [
        ({"parameters": ["mass of *", "moment*", "inertia*"]}, "friction or a spring is missing"),
        ({"parameters": ["mass of *"]}, "correlated from sample to sample"),
        ({"cut_off": 2.0}, "correlated from sample to sample"),
    ],
)
def test_a_model_that_lacks_something_is_a_problem_and_no_refusal(arguments: Any, cause: str) -> None:
    _, records = of_five_bar()
    fit = fit_of(records, **arguments)
    assert any(cause in problem for problem in fit.problems), fit.problems
    assert not any("would leave" in problem or "Columns" in problem for problem in fit.problems)  # nothing unverified


@pytest.mark.parametrize(
    ("shift", "every"),
    [*((shift, every) for shift in (0.004, 0.02, 0.1, -0.05) for every in (1, 2)), (0.35, 1), (-0.5, 1), (0.7, 1)],
)
def test_shifts_in_time_are_named_in_seconds(shift: float, every: int) -> None:
    _, records = of_five_bar()
    problems = fit_of(late_by(shift, records, every)).problems
    assert_shift(problems, shift, "")
    assert not any("Columns" in problem for problem in problems)


def test_the_record_that_is_shifted_is_named() -> None:
    _, records = of_five_bar()
    assert_shift(fit_of([records, late_by(0.1, records)]).problems, 0.1, " in records[1]")


def late_by(shift: float, records: Records, every: int = 1) -> Records:
    """Return records whose efforts are late; the part that was measured in both is kept."""
    known = (records.t - shift >= records.t[0]) & (records.t - shift <= records.t[-1])
    late = np.stack([np.interp(records.t - shift, records.t, column) for column in records.effort.T], axis=1)
    return Records(*(array[known][::every] for array in (records.t, late, records.position)))


def assert_shift(problems: tuple[str, ...], shift: float, where: str) -> None:
    found = re.search(r"Efforts (\S+) s (later|earlier) than the positions(.*) would", " ".join(problems))
    assert found, problems
    assert float(found[1]) == pytest.approx(abs(shift), rel=0.1, abs=5e-4)
    assert found[2] == ("later" if shift > 0.0 else "earlier")
    assert found[3] == where
    remedy = re.search(r"add (\S+) s to the times of the efforts", " ".join(problems))
    assert remedy
    assert float(remedy[1]) == pytest.approx(-shift, rel=0.1, abs=5e-4)


@pytest.mark.parametrize(
    ("change", "columns"),
    [
        (lambda u: u * [1.0, -1.0], "base_1, -base_2"),
        (lambda u: u * [-1.0, 1.0], "-base_1, base_2"),
        (lambda u: u[:, ::-1], "base_2, base_1"),
        (lambda u: -u[:, ::-1], "-base_2, -base_1"),
        (lambda u: -u, "-base_1, -base_2"),
    ],
)
def test_signs_and_order_of_efforts_are_named(change: Any, columns: str) -> None:
    _, records = of_five_bar()
    fit = fit_of(with_efforts(records, change(records.effort)))
    assert f"Columns of the efforts seem to be those of {columns}." in fit.problems


def test_motors_in_cyclic_order_are_all_named() -> None:
    given = declared("delta")
    records = noisy(measured(rp.RneaDynamics(built(given)), seconds=4.0), seed=1)
    a, b, c = given.actuated
    fit = identify(given, with_efforts(records, records.effort[:, [1, 2, 0]]), cut_off=CUT_OFF)
    assert f"Columns of the efforts seem to be those of {c}, {a}, {b}." in fit.problems


def test_gaps_are_refused_with_their_time_and_parts_are_not() -> None:
    true, records = of_five_bar()
    parts = [
        Records(*(array[own] for array in (records.t, records.effort, records.position)))
        for own in (records.t < 1.5, records.t > 2.5)
    ]
    whole = Records(*(np.concatenate([getattr(p, n) for p in parts]) for n in ("t", "effort", "position")))
    with pytest.raises(rp.errors.InputError, match=r"gap from t = 1\.496 s to 2\.504 s"):
        fit_of(whole)
    fit = fit_of(parts)
    assert not fit.problems
    assert np.abs(deviations(fit, true)).max() < 4.0
    k = records.t > 1.0
    lone = Records(*(np.concatenate([a[:1], a[k]]) for a in (records.t, records.effort, records.position)))
    with pytest.raises(rp.errors.InputError, match=r"gap from t = 0 s to 1\.004 s"):
        fit_of(lone)


def test_little_motion_is_known_little_and_not_refused() -> None:
    true, _ = of_five_bar()
    exact = measured(rp.RneaDynamics(true), seconds=4.0, speed=1.0)
    rng = np.random.default_rng(0)
    noise = 0.05 * rng.standard_normal(exact.effort.shape)
    fit = fit_of(with_efforts(exact, exact.effort + noise))
    assert np.abs(deviations(fit, true)).max() < 4.0
    sizes = fit.base.sizes[fit.base.independent]
    weak = (fit.intervals[:, 1] - fit.values) > sizes
    assert weak.any()
    assert not weak.all()
    said = next(problem for problem in fit.problems if "more motion is needed" in problem)
    leading = [fit.base.parameters[k].name for k in fit.base.independent]
    assert [name in said for name in leading] == weak.tolist()
    # at rest nothing is seen
    still = Records(exact.t, exact.effort, 0.0 * exact.position + exact.position[0])
    nothing = fit_of(still)
    assert (nothing.status, len(nothing.base)) == (ResultStatus.UNRESOLVED, 0)
    assert set(nothing.base.unseen) == {p.name for p in parameters_of(declared_without_carriers())}


def test_one_freedom_shows_what_it_shows() -> None:
    """A four-bar: base parameters of the motion, true ones within their intervals, nothing to leave out by hand."""
    given = declared("four_bar")
    true = built(given)
    fit = identify(given, noisy(measured(rp.RneaDynamics(true), seconds=8.0), seed=2), cut_off=CUT_OFF)
    assert np.abs(deviations(fit, true)).max() < 4.0
    carried = rp.load_robot("five_bar", carriers=True)
    _, records = of_five_bar()
    without_forces = identify(carried, records, cut_off=CUT_OFF)
    assert without_forces.status is ResultStatus.OK
    assert len(without_forces.base) == 11


@pytest.mark.parametrize(("mass", "length"), [(1e-9, 1.0), (1e-4, 1e-2), (1e9, 1e2)])
def test_units_decide_nothing(mass: float, length: float) -> None:
    """The same machine of other size: as many parameters, the same relative intervals."""

    def of_size(mass: float, length: float) -> Fit:
        parts = ("proximal_length", "distal_length", "tail_length", "base_distance")
        sizes = dict.fromkeys(parts, 0.5 * length)
        sizes |= {"proximal_mass": 0.5 * mass, "end_effector_mass": 0.2 * mass}
        time = np.sqrt(length)
        motors = [rp.JointForces(joint, friction_speed=0.01 / time) for joint in FIVE_BAR.actuated]
        given, true = (rp.load_robot("five_bar", **sizes, distal_mass=m * mass).loaded(*motors) for m in (0.5, 0.7))
        t = np.arange(0.0, 4.0, 0.004) * time
        w = 2.0 * np.pi * np.array([0.7, 1.1, 1.6]) / time
        sines, cosines = np.sin(t[:, None] * w), np.cos(t[:, None] * w)
        size = length * np.array([[0.06, 0.03], [0.03, 0.05], [0.02, 0.02]])
        x = length * np.array([0.25, 0.76]) + sines @ size
        path = rp.PlatformMotion(t, x, cosines * w @ size, -sines * w**2 @ size)
        tau = rp.inverse_dynamics(true, path).efforts.tau
        noise = 0.02 * tau.std(axis=0) * np.random.default_rng(1).standard_normal(tau.shape)
        position = true.joint_positions(rp.inverse_kinematics(true, path).q)
        return identify(given, Records(t, tau + noise, position), cut_off=CUT_OFF / time)

    one, other = of_size(1.0, 1.0), of_size(mass, length)
    assert len(one.base) == len(other.base) == 11
    sizes = (fit.base.sizes[fit.base.independent] for fit in (one, other))
    first, second = (fit.standard_deviation / size for fit, size in zip((one, other), sizes, strict=True))
    assert np.allclose(first, second, rtol=1e-3)


@pytest.mark.parametrize(("mass", "least"), [(0.15, 1e-9), (0.02, 0.0)])
def test_rotors_behind_gears_stay_what_they_can_be(mass: float, least: float) -> None:
    """Rotors of 1e-5 kg·m² take a small part of a lost mass; they end at zero where that is more than they have."""
    motors = [rp.JointForces(j, damping=0.8, friction=0.5, rotor_inertia=1e-5, gear=50.0) for j in FIVE_BAR.actuated]
    given = FIVE_BAR.loaded(*motors)
    true = rp.load_robot("five_bar", distal_mass=mass).loaded(*motors)
    fit = identify(given, noisy(measured(rp.RneaDynamics(true)), seed=3), cut_off=CUT_OFF)
    assert all(load.rotor_inertia >= least for load in fit.robot.loads)
    assert prediction(fit, true, seed=9) < 0.01


def test_sensors_have_offsets_and_factors() -> None:
    """Currents times nominal torque constants: of all motors where a mass is known, of one less where none is."""
    true, records = of_five_bar()
    fit = fit_of(with_efforts(records, records.effort + np.array([0.5, -0.2])), sensors=["offset of *"])
    within = dict(zip(fit.base.names, fit.intervals, strict=True))
    for name, offset in (("offset of base_1", 0.5), ("offset of base_2", -0.2)):
        assert np.diff(within[name]) < 0.03
        assert within[name][0] - 0.01 < offset < within[name][1] + 0.01
    assert not fit.problems
    assert prediction(fit, true, seed=9) < 0.02
    currents = with_efforts(records, records.effort / [1.2, 0.9])
    ratio = fit_of(currents, sensors=["factor of base_2"])
    low, high = ratio.intervals[-1]
    assert low - 0.05 < 0.75 < high + 0.05
    assert high - low < 0.3
    given = replace(true, loads=FIVE_BAR.loads)
    known = identify(given, currents, cut_off=CUT_OFF, parameters=["friction of b*", "damping of b*"], sensors=["f*"])
    assert known.values[-2:] == pytest.approx([1.2, 0.9], rel=0.02)
    assert (np.abs(known.values[-2:] - [1.2, 0.9]) < 4.0 * known.standard_deviation[-2:]).all()
    none = fit_of(currents, parameters=["moment*", "inertia*"], sensors=["factor of *"])
    assert "No known mass or force sets the scale" in none.problems[0]
    assert none.status is ResultStatus.NOT_CONVERGED
    with pytest.raises(rp.errors.InputError, match="No parameter of five_bar is named 'factor of bas'"):
        fit_of(currents, sensors=["factor of bas"])


@pytest.mark.parametrize("filter", [[0.5, 0.5, 0.5, 0.5], [0.95, -0.31]])
def test_intervals_allow_for_noise_that_is_not_white(filter: list[float]) -> None:
    """Correlation of either sign is told, and intervals hold: those of white noise hold 67 % of the time, or 99."""
    true, _ = of_five_bar()
    exact, off = measured(rp.RneaDynamics(true), seconds=4.0), []
    for seed in range(12):
        white = 0.05 * exact.effort.std(axis=0) * np.random.default_rng(seed).standard_normal(exact.effort.shape)
        noise = np.apply_along_axis(np.convolve, 0, white, filter, "same")
        fit = fit_of(with_efforts(exact, exact.effort + noise))
        assert any("correlated from sample to sample" in problem for problem in fit.problems)
        assert (np.sign(fit.whiteness) == np.sign(filter[1])).all()
        off.append(deviations(fit, true))
    assert (np.abs(off) < Z95).mean() > 0.88
    assert 0.8 < np.sqrt(np.mean(np.square(off))) < 1.25


def test_each_record_has_its_own_noise() -> None:
    """One per cent and twenty: intervals of both together hold, and are those of the better one, or less."""
    true, _ = of_five_bar()
    exact, off = [measured(rp.RneaDynamics(true), seconds=2.5, seed=seed) for seed in (0, 1)], []
    for seed in range(6):
        records = [
            noisy(one, 2 * seed + k, effort=part) for k, (one, part) in enumerate(zip(exact, (0.01, 0.2), strict=True))
        ]
        fit = fit_of(records)
        wanted = [part * one.effort.std(axis=0) for one, part in zip(exact, (0.01, 0.2), strict=True)]
        assert np.allclose(fit.effort_noise, wanted, rtol=0.15)
        off.append(deviations(fit, true))
    assert 0.75 < np.sqrt(np.mean(np.square(off))) < 1.3
    assert (fit.standard_deviation < 1.1 * fit_of(records[0]).standard_deviation).all()


def frictionless(true: Robot) -> Robot:
    return replace(true, loads=declared_without_carriers().loads)


@pytest.mark.parametrize(("draws", "within"), [(12, 0.06), pytest.param(200, 0.02, marks=pytest.mark.long)])
def test_intervals_of_factors_and_offsets_hold_at_any_factor(draws: int, within: float) -> None:
    """effort = factor · reading − offset: the same intervals in whatever unit readings are, and they hold."""
    true, _ = of_five_bar()
    exact, given = measured(rp.RneaDynamics(true), seconds=2.0, rate=150.0), frictionless(true)
    offset, factors, off = np.array([0.3, -0.2]), [0.5, 1.0, 2.0], np.empty((3, draws, 8))
    for i, j in np.ndindex(3, draws):
        effort = noisy(exact, seed=j, counts=2.0**20).effort
        readings = (effort + offset) / factors[i]
        fit = identify(
            given,
            with_efforts(exact, readings),
            cut_off=CUT_OFF,
            parameters=["damping of b*", "friction of b*"],
            sensors=["factor of *", "offset of *"],
        )
        assert fit.status is ResultStatus.OK
        own = {p.name: p.value for p in parameters_of(true, ["damping of b*", "friction of b*"])}
        own |= {f"factor of {joint}": factors[i] for joint in true.actuated}
        own |= {f"offset of {joint}": o for joint, o in zip(true.actuated, offset, strict=True)}
        truth = np.array([own[name] for name in fit.base.names])
        off[i, j] = (fit.values - truth) / fit.standard_deviation
    assert np.abs(off - off[1]).max() < 0.1
    assert abs((np.abs(off[1]) < Z95).mean() - 0.95) < within


def test_a_factor_beside_all_masses_has_no_bias() -> None:
    """Noise of a reading is in the regressor too: an estimate that ignores it is 3 standard deviations too small."""
    true, _ = of_five_bar()
    exact = measured(rp.RneaDynamics(true), seconds=3.0)
    off = []
    for seed in range(6):
        records = noisy(exact, seed)
        fit = fit_of(with_efforts(records, records.effort / [0.8, 1.0]), sensors=["factor of base_1"])
        off.append((fit.values[-1] - 0.8) / fit.standard_deviation[-1])
    assert abs(np.mean(off)) < 1.3


def test_a_base_that_is_not_level_is_found() -> None:
    machine, tilt = built(declared("delta")), np.array([0.05, -0.03, 0.0])
    true = tilted(machine, tilt)
    records = noisy(measured(rp.RneaDynamics(true), seconds=4.0), seed=1)
    sought = ["mass of platform", "damping of m*", "friction of m*"]
    fit = identify(machine, records, cut_off=CUT_OFF, parameters=sought, sensors=["tilt * of gravity"])
    assert fit.base.unseen == ("tilt z of gravity",)
    assert (np.abs(fit.values[-2:] - tilt[:2]) < 4.0 * fit.standard_deviation[-2:]).all()
    assert (fit.standard_deviation[-2:] < 0.002).all()
    assert np.linalg.norm(fit.robot.gravity - true.gravity) < 0.05
    assert prediction(fit, true, seed=9) < 0.02


# --- real bodies -----------------------------------------------------------------------------------------------------


def eigenvalues(robot: Robot) -> Array:
    """Return (bodies,) the least eigenvalue of each pseudo-inertia relative to its largest."""
    spectra = [np.linalg.eigvalsh(pin.PseudoInertia.FromInertia(i).toMatrix()) for i in robot.model.inertias[1:]]
    return np.array([values[0] / max(values[-1], 1e-300) for values in spectra])


def test_bodies_are_real_ones_where_asked() -> None:
    given = declared("five_bar")
    true = built(given)
    records = noisy(measured(rp.RneaDynamics(true), seconds=3.0), seed=1, effort=0.3)
    plain, fit = (identify(given, records, cut_off=CUT_OFF, physical=one) for one in (False, True))
    assert (eigenvalues(fit.robot) > -1e-12).all()
    assert all(load.damping >= 0.0 and load.friction >= 0.0 for load in fit.robot.loads)
    assert np.array_equal(fit.values, plain.values)
    change = fit.base.combination @ fit.parameters_after - fit.values
    assert np.abs(change / fit.standard_deviation).max() < 4.0
    assert fit.status is ResultStatus.OK


@pytest.mark.parametrize("name", ["five_bar", "delta"])
def test_the_nearest_real_bodies_are_the_nearest(name: str) -> None:
    """Karush, Kuhn and Tucker: no real body lies on the side where the misfit decreases; so the minimum is global."""
    given = declared(name)
    records = noisy(measured(rp.RneaDynamics(built(given)), seconds=3.0), seed=1, effort=0.3)
    fit = identify(given, records, cut_off=CUT_OFF, physical=True)
    assert fit.status is ResultStatus.OK
    base, scaled = fit.base, fit.parameters_after / fit.base.sizes
    by_scaled = base.combination * base.sizes
    gradient = by_scaled.T @ np.linalg.solve(fit.covariance, by_scaled @ scaled - fit.values)
    upper = np.triu_indices(4)
    units = np.array([pin.PseudoInertia.FromDynamicParameters(unit).toMatrix() for unit in np.eye(10)])
    for body in dict.fromkeys(p.of for p in base.parameters if p.kind in INERTIAL):
        own = [k for k, p in enumerate(base.parameters) if p.of == body and p.kind in INERTIAL]
        half = np.zeros((4, 4))  # the gradient is the trace of G with the pseudo-inertia of a change
        half[upper] = np.linalg.solve(units[:, upper[0], upper[1]], gradient[own])
        G = 0.5 * (half + half.T)
        assert np.linalg.eigvalsh(G)[0] > -1e-2
        assert abs((G * np.tensordot(scaled[own], units, 1)).sum()) < 1e-2
    for k, p in enumerate(base.parameters):
        if p.kind in ("damping", "friction"):
            assert gradient[k] > -1e-2
            assert abs(gradient[k] * scaled[k]) < 1e-2


def test_real_bodies_that_are_not_found_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    _, records = of_five_bar()
    fit = fit_of(records, physical=True)
    assert fit.status is ResultStatus.OK
    weight = np.linalg.inv(np.linalg.cholesky(fit.covariance))
    assert not nearest_physical(fit.base, fit.values, 1e9 * weight)[1]  # lost in rounding
    monkeypatch.setattr(physical, "_BARRIERS", physical._BARRIERS[:3])  # as far as rounding might allow
    fit = fit_of(records, physical=True)
    assert fit.status is ResultStatus.NOT_CONVERGED
    assert "The nearest real bodies were not found." in fit.problems


@pytest.mark.parametrize(
    ("parameters", "missing"),
    [
        (["mass of *", "moment x*", "moment y*", "inertia zz*"], "moment z of proximal_1, inertia xx of proximal_1"),
        (["moment *", "damping*"], "mass of proximal_1"),
    ],
)
def test_bodies_in_part_are_no_real_ones(parameters: list[str], missing: str) -> None:
    _, records = of_five_bar()
    with pytest.raises(rp.errors.InputError, match=f"sought in part.*Add {missing}"):
        fit_of(records, parameters=parameters, physical=True)


def test_bodies_that_are_not_real_are_named() -> None:
    given = declared("gough")
    records = noisy(measured(rp.RneaDynamics(built(given)), seconds=2.0), seed=1)
    fit = identify(given, records, cut_off=CUT_OFF)
    values = {p.name: v for p, v in zip(fit.base.parameters, fit.parameters_after, strict=True)}
    sought = {p.of for p in fit.base.parameters if p.kind in INERTIAL}
    before, after = (
        eigenvalues(given),
        np.array(
            [
                np.linalg.eigvalsh(
                    pin.PseudoInertia.FromDynamicParameters(
                        np.array([values.get(f"{kind} of {body.name}", 0.0) for kind in INERTIAL])
                    ).toMatrix()
                )[0]
                for body in given.bodies
            ]
        ),
    )
    bad = {
        b.name for b, was, now in zip(given.bodies, before, after, strict=True) if b.name in sought and now < 0.0 < was
    }
    assert bad
    told = next(problem for problem in fit.problems if problem.startswith("Negative"))
    assert set(re.findall(r"pseudo-inertia of (\w+)", told)) == bad


def test_masses_alone_are_positive_where_asked() -> None:
    light = rp.load_robot("five_bar", distal_mass=0.001, end_effector_mass=0.0)
    records = noisy(measured(rp.RneaDynamics(light), seconds=3.0), seed=1, effort=0.3)
    plain, fit = (
        identify(FIVE_BAR, records, cut_off=CUT_OFF, parameters=["mass of *"], physical=one) for one in (False, True)
    )
    negative = [body.name for body in plain.robot.bodies if body.mass < 0.0]
    assert negative
    assert all(any(f"mass of {name}" in problem for problem in plain.problems) for name in negative)
    assert all(body.mass > 0.0 for body in fit.robot.bodies)
    told = " ".join(problem for problem in fit.problems if "Negative" in problem)
    spectra = [np.linalg.eigvalsh(pin.PseudoInertia.FromInertia(i).toMatrix())[0] for i in fit.robot.model.inertias[1:]]
    bad = {body.name for body, least in zip(fit.robot.bodies, spectra, strict=True) if least < -1e-9}
    assert set(re.findall(r"pseudo-inertia of (\w+)", told)) == bad  # held moments do not fit the mass
    assert "mass of" not in told
    # bodies without mass in the given robot
    given = declared("delta")
    everything = ["mass of *", "moment*", "inertia*", "damping*", "friction*"]
    records = noisy(measured(rp.RneaDynamics(built(given)), seconds=1.5), seed=1)
    fit = identify(given, records, cut_off=CUT_OFF, parameters=everything, physical=True)
    assert (eigenvalues(fit.robot) > -1e-12).all()


# --- what is refused -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda r: Records(r.t[:30], r.effort[:30], r.position[:30]), "30 samples in 0.116 s"),
        (lambda r: Records(r.t[:1], r.effort[:1], r.position[:1]), "1 samples in 0 s"),
        (lambda r: Records(r.t, r.effort, r.position + 3.0), "leaves the working mode"),
        (lambda r: Records(r.t, r.effort[:, :1], r.position), "effort has 1 columns"),
    ],
)
def test_bad_records_are_named(spoil: Any, message: str) -> None:
    _, records = of_five_bar()
    with pytest.raises(rp.errors.InputError, match=message):
        fit_of(spoil(records))


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ([], "parameters is empty"),
        (["mass of *", "preload of base_1"], "preload of base_1 belongs to a spring without stiffness"),
    ],
)
def test_parameters_that_cannot_be_sought_are_named(parameters: list[str], message: str) -> None:
    _, records = of_five_bar()
    with pytest.raises(rp.errors.InputError, match=message):
        fit_of(records, parameters=parameters)


def test_springs_are_found_and_make_a_robot() -> None:
    given = declared_without_carriers()
    true = built(given)
    springs = [replace(load, stiffness=6.0, rest=0.3) for load in true.loads]
    true = replace(true, loads=tuple(springs))
    fit = fit_of(
        noisy(measured(rp.RneaDynamics(true)), seed=3),
        parameters=[
            "mass*",
            "moment*",
            "inertia*",
            "damping of base*",
            "friction of base*",
            "*s of base*",
            "preload of base*",
        ],
    )
    assert np.abs(deviations(fit, true)).max() < 4.0
    assert [load.stiffness for load in fit.robot.loads] == pytest.approx([6.0, 6.0], rel=0.1)
    assert [load.rest for load in fit.robot.loads] == pytest.approx([0.3, 0.3], abs=0.1)


def test_a_parameter_that_no_motion_shows_is_named() -> None:
    _, records = of_five_bar()
    fit = fit_of(records, parameters=["mass of proximal_1"])
    assert fit.status is ResultStatus.UNRESOLVED
    assert fit.base.unseen == ("mass of proximal_1",)
    assert fit.summary()["unseen"] == ["mass of proximal_1"]
    assert "1 parameters, base.unseen" in str(fit.summary())


@pytest.mark.parametrize("effort", ["zero", "noise"])
def test_efforts_that_nothing_explains_are_a_problem(effort: str) -> None:
    _, records = of_five_bar()
    efforts = np.random.default_rng(0).standard_normal(records.effort.shape) * (effort == "noise")
    assert any("explains 0%" in problem for problem in fit_of(with_efforts(records, efforts)).problems)


@pytest.mark.parametrize("scale", [1e12, 1e-12])
def test_units_of_the_efforts_are_doubted_and_decide_nothing(scale: float) -> None:
    _, records = of_five_bar()
    fit = fit_of(with_efforts(records, scale * records.effort))
    assert fit.base.names == fit_of(records).base.names
    assert any("times those of five_bar as declared: check the units" in problem for problem in fit.problems)
    assert np.abs(fit.whiteness).max() <= 1.0


@pytest.mark.parametrize("effort", [0.0, 3.0])
def test_a_dead_motor_is_named(effort: float) -> None:
    _, records = of_five_bar()
    told = fit_of(with_efforts(records, np.stack([records.effort[:, 0], 0.0 * records.t + effort], axis=1))).problems
    assert [p for p in told if "is dead" in p] == [
        "The effort of base_2 is the same throughout records[0]: its motor or sensor is dead."
    ]


@pytest.mark.parametrize("columns", [[0], [0, 1]])
def test_one_reading_far_from_all_others_is_named(columns: list[int]) -> None:
    _, records = of_five_bar()
    effort = records.effort.copy()
    effort[300, columns] = 1e6
    fit = fit_of(with_efforts(records, effort))
    told = [p for p in fit.problems if f"has a size of 1e+06 at t = {records.t[300]:g} s in records[0]" in p]
    assert len(told) == len(columns)
    assert not any("units" in problem for problem in fit.problems)


def test_negative_damping_is_refused_with_a_remedy_that_works() -> None:
    _, records = of_five_bar()
    driven = with_efforts(records, records.effort - 2.0 * np.gradient(records.position, records.t, axis=0))
    with pytest.raises(rp.errors.InputError, match=r"damping of base_1, damping of base_2\. .*physical=True"):
        _ = fit_of(driven).robot
    assert all(load.damping >= 0.0 for load in fit_of(driven, physical=True).robot.loads)


def test_a_body_whose_ten_are_zero_is_none() -> None:
    chosen = parameters_of(FIVE_BAR, ["* of distal_1"])
    model = with_values(FIVE_BAR, chosen, np.zeros(10)).model
    nothing = [body.name for body, inertia in zip(FIVE_BAR.bodies, model.inertias[1:], strict=True) if not inertia.mass]
    assert nothing == ["distal_1"]
    assert not model.inertias[chosen[0].joint].toDynamicParameters().any()


def test_records_say_what_they_do_not_hold() -> None:
    with pytest.raises(rp.errors.InputError, match="does not increase: 1 s at sample 2"):
        Records([0.0, 1.0, 1.0], np.zeros((3, 2)), np.zeros((3, 2)))
    with pytest.raises(rp.errors.InputError, match="not both"):
        Records([0.0, 1.0], np.zeros((2, 2)))
    with pytest.raises(rp.errors.InputError, match="no sample"):
        Records([], np.zeros((0, 2)), np.zeros((0, 2)))
    for records in ([], [1, 2], None):
        with pytest.raises(rp.errors.InputError, match="cut_off"):
            identify("five_bar", records, cut_off=10.0)  # type: ignore[arg-type]
    carried = Records([0.0, 1.0], *[np.zeros((2, 2))] * 2, carriers=np.zeros((2, 2)), carrier_force=np.zeros((2, 2)))
    bare = Records([0.0, 1.0], *[np.zeros((2, 2))] * 2, carriers=np.zeros((2, 2)))
    with pytest.raises(rp.errors.InputError, match="Some records have carrier_force and some have none"):
        identify(declared("five_bar"), [carried, bare], cut_off=10.0)


def test_motions_through_a_singularity_are_explained() -> None:
    """The carriers of the thesis take the 2-RPR through its singular line: efforts are finite, W loses rank."""
    given, true = zoo.robot_of("2rpr"), zoo.robot_of("2rpr", carrier_mass=1.7)
    circle = rp.trajectory.reference.circle(speed=0.5)
    plan = rp.plan_switch_off(rp.VirtualWork(true), circle, threshold=20.0, mesh=rp.Mesh(dt=0.01))
    table = plan.table(500.0, two_sided=False)
    x = np.stack([values for _, values in table.platform.values()], axis=1)[:, :2]
    rng = np.random.default_rng(3)
    efforts = table.effort + 0.05 * table.effort.std(axis=0) * rng.standard_normal(table.effort.shape)
    singular = (
        np.linalg.cond(rp.inverse_kinematics(given, circle.sample_at(table.t.clip(0.0, circle.duration))).W) > 20.0
    )
    assert 10 < singular.sum() < 0.5 * len(singular)

    def between(first: int, last: int) -> Records:
        part = slice(first, last)
        return Records(
            table.t[part],
            efforts[part, : given.m],
            platform=x[part],
            carriers=table.position[part, given.m :],
            carrier_force=efforts[part, given.m :],
        )

    first, last = np.flatnonzero(singular)[[0, -1]]
    alone = slice(max(first - 60, 0), last + 60)  # splines lose their ends
    patterns = ["mass of mass*", "moment [xy] of mass*"]
    for records in (between(0, len(table.t)), between(alone.start, alone.stop)):
        fit = identify(given, records, cut_off=40.0, parameters=patterns)
        assert fit.status is ResultStatus.OK
        assert np.abs(deviations(fit, true)).max() < 4.0
        assert fit.standard_deviation[0] < 0.1 * fit.values[0]
