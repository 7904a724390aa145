"""Parameters from measured motions: against machines whose parameters are known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import zoo
from engines import drive_of_motion, run_exudyn, run_mujoco
from measured import built, declared, measured, noisy, true_values

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.identification import Fit, Records, identify
from redundancy_pin.identification.fit import _Equations
from redundancy_pin.identification.records import smooth_motion
from redundancy_pin.robot import Robot

CUT_OFF = 12.0
"""Hz: the motions have parts up to 1.3 Hz, and their products a few times that."""


def relative_error(found: Array, true: Array) -> float:
    return float(np.linalg.norm(found - true) / np.linalg.norm(true - true.mean(axis=0)))


def prediction(fit: Fit, robot: Robot, seed: int) -> float:
    """Return the error of f by a fit on a motion that it has not seen, relative to the size of f."""
    t = np.linspace(0.0, 3.0, 60)
    motion, carriers = zoo.smooth_motion(robot, seed=seed, speed=8.0).at(t), zoo.carriers_at(robot, t, seed)
    return relative_error(*(rp.RneaDynamics(one).reduce(motion, carriers).f for one in (fit.robot, robot)))


@pytest.mark.parametrize("name", ["five_bar", "delta"])
def test_a_machine_with_noise_is_found_within_its_intervals(name: str) -> None:
    given = declared(name)
    true = built(given)
    fit = identify(given, noisy(measured(rp.RneaDynamics(true)), seed=1), cut_off=CUT_OFF)
    off = (fit.values - true_values(fit, true)) / fit.standard_deviation
    assert np.abs(off).max() < 4.0
    assert 0.6 < np.sqrt((off**2).mean()) < 1.5
    assert np.abs(fit.whiteness).max() < 4.0 / np.sqrt(len(fit.t))
    assert prediction(fit, true, seed=9) < 0.01
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


def coverage(name: str, draws: int) -> tuple[Array, float]:
    """Return by parameter and pooled how often intervals hold the truth: white noise of 5 %, one simulation."""
    given = declared(name)
    true = built(given)
    exact = measured(rp.RneaDynamics(true), seconds=5.0, rate=200.0)
    records = noisy(exact, seed=0, effort=0.0)
    first = identify(given, records, cut_off=CUT_OFF)
    smooth = smooth_motion(given, records, CUT_OFF)
    equations = _Equations.of(given, [records], [smooth], first.base, given.k > 0)
    truth, rng = true_values(first, true) - first.base.values, np.random.default_rng(5)
    inside = np.zeros(len(truth))
    for _ in range(draws):
        noise = 0.05 * equations.effort.std(axis=0) * rng.standard_normal(equations.effort.shape)
        solved = replace(equations, effort=equations.effort + noise).solve()
        half = 1.959964 * np.sqrt(np.diagonal(np.linalg.inv(solved.information)))
        inside += np.abs(solved.change - truth) < half
    return inside / draws, float(inside.mean() / draws)


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    each, pooled = coverage("five_bar", 400)
    assert abs(pooled - 0.95) < 0.01
    assert each.min() > 0.91
    assert each.max() < 0.98


def test_bodies_are_real_ones_where_asked() -> None:
    given = declared("five_bar")
    true = built(given)
    records = noisy(measured(rp.RneaDynamics(true), seconds=3.0), seed=1, effort=0.3)
    plain, fit = (identify(given, records, cut_off=CUT_OFF, physical=one) for one in (False, True))
    for inertia in fit.robot.model.inertias[1:]:
        values = np.linalg.eigvalsh(pin.PseudoInertia.FromInertia(inertia).toMatrix())
        assert values[0] > -1e-12 * max(values[-1], 1e-300)
    assert all(load.damping >= 0.0 and load.friction >= 0.0 for load in fit.robot.loads)
    assert np.array_equal(fit.values, plain.values)
    change = fit.base.combination @ fit.parameters_after - fit.values
    assert np.abs(change / fit.standard_deviation).max() < 4.0


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda r: Records(r.t, r.effort * [1.0, -1.0], r.position), "The effort of base_2: the sign is wrong"),
        (lambda r: Records(r.t, r.effort[:, ::-1], r.position), "efforts of base_1 and base_2 are swapped"),
        (lambda r: Records(r.t, -r.effort, r.position), "Efforts of base_1, base_2: the sign is wrong"),
        (lambda r: Records(r.t, np.roll(r.effort, 8, axis=0), r.position), "shifted in time"),
        (lambda r: Records(r.t, r.effort, 0.0 * r.position + r.position[0]), "too little: 1. of 11"),
        (lambda r: Records(r.t[:30], r.effort[:30], r.position[:30]), "30 samples in 0.116 s"),
        (lambda r: Records(r.t, r.effort, r.position + 3.0), "leaves the working mode"),
        (lambda r: Records(r.t, r.effort[:, :1], r.position), "effort has 1 columns"),
    ],
)
def test_bad_records_are_named(spoil: Any, message: str) -> None:
    given = zoo.robot_of("five_bar", carriers=False)
    records = noisy(measured(rp.RneaDynamics(built(given)), seconds=4.0), seed=1)
    with pytest.raises(rp.errors.InputError, match=message):
        identify(given, spoil(records), cut_off=CUT_OFF)


def test_records_say_what_they_do_not_hold() -> None:
    with pytest.raises(rp.errors.InputError, match="does not increase: 1 s at sample 2"):
        Records([0.0, 1.0, 1.0], np.zeros((3, 2)), np.zeros((3, 2)))
    with pytest.raises(rp.errors.InputError, match="not both"):
        Records([0.0, 1.0], np.zeros((2, 2)))
    with pytest.raises(rp.errors.InputError, match="cut_off"):
        identify("five_bar", [], cut_off=10.0)


def test_a_singular_stretch_adds_to_what_is_known() -> None:
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
    pieces = [between(0, first), between(last, len(table.t))]
    patterns = ["mass of mass*", "moment [xy] of mass*"]
    whole, without = (
        identify(given, records, cut_off=40.0, parameters=patterns) for records in (between(0, len(table.t)), pieces)
    )
    for fit in (whole, without):
        off = (fit.values - true_values(fit, true)) / fit.standard_deviation
        assert np.abs(off).max() < 4.0
    assert (whole.standard_deviation < 1.001 * without.standard_deviation).all()
    assert (whole.standard_deviation / without.standard_deviation).min() < 0.9
