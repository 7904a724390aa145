"""Identification of machines that outside engines have moved: 5 % of noise, encoders of 17 bits, friction."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
import zoo
from engine_records import Measured, efforts_of, engine_records, with_noise
from engines import run_mujoco
from engines.cases import SHORT, prepare
from measured import true_values
from scipy.interpolate import make_lsq_spline
from scipy.stats import norm

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.identification import Fit, Records, chain_regressor, identify
from redundancy_pin.identification.parameters import INERTIAL
from redundancy_pin.robot import Robot
from redundancy_pin.status import ResultStatus

CUT_OFF = 12.0
Z95 = float(norm.ppf(0.975))


@cache
def machine(name: str, engine: str) -> tuple[Measured, Fit]:
    pytest.importorskip(engine, reason=f"{engine} is in the extra engines")
    measured = engine_records(name, engine)
    return measured, identify(measured.given, with_noise(measured, 1), cut_off=CUT_OFF)


@pytest.mark.parametrize(
    ("name", "engine"),
    [("five_bar", "exudyn"), ("five_bar", "mujoco"), ("delta", "mujoco"), ("3rrr", "mujoco")],
)
def test_a_machine_that_an_engine_moves_is_identified(name: str, engine: str) -> None:
    measured, fit = machine(name, engine)
    true = true_values(fit, measured.true)
    off = (fit.values - true) / fit.standard_deviation
    assert all("more motion is needed" in problem for problem in fit.problems)  # of the rods of a delta, in 3 s
    assert fit.status is ResultStatus.OK
    assert np.abs(off).max() < 4.0
    assert (np.abs(off) < Z95).mean() > 0.95 - 3.0 * np.sqrt(0.05 * 0.95 / len(off))
    known = Z95 * fit.standard_deviation < 0.01 * np.abs(true)  # what three seconds show to a hundredth is so
    assert (np.abs(fit.values - true)[known] < 0.013 * np.abs(true)[known]).all()
    # a motion that was not used: errors of the efforts within twice the noise of the records
    predicted = efforts_of(measured.given, fit), efforts_of(fit.robot)
    wanted, before = efforts_of(measured.true), efforts_of(measured.given)
    noise = 0.05 * measured.exact.effort.std(axis=0)
    for each in predicted:
        assert (np.sqrt(((each - wanted) ** 2).mean(axis=0)) < 2.0 * noise).all()
    assert (np.sqrt(((before - wanted) ** 2).mean(axis=0)) > 2.0 * noise).any()


def part_of(records: Records, part: slice, effort: Array, force: Array) -> Records:
    columns = {"carriers": records.carriers[part], "carrier_force": force[part]}
    return Records(records.t[part], effort[part], records.position[part], **columns)


def late(records: Records, effort: Array) -> Array:
    """Return efforts as a clock that is 20 ms slow would store them."""
    return np.stack([np.interp(records.t - 0.02, records.t, column) for column in effort.T], axis=1)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda r: (r.effort * [1.0, -1.0], r.carrier_force), "base_1, -base_2,"),
        (lambda r: (r.effort[:, ::-1], r.carrier_force), "base_2, base_1,"),
        (
            lambda r: (late(r, r.effort), late(r, r.carrier_force)),
            r"Efforts 0\.0(19|20|2)\d* s later|Residuals follow the rates",
        ),
    ],
)
def test_records_of_an_engine_that_were_spoiled_are_named(
    change: Callable[[Records], tuple[Array, Array]], named: str
) -> None:
    measured, _ = machine("five_bar", "mujoco")
    records = with_noise(measured, 1)
    fit = identify(measured.given, part_of(records, slice(None), *change(records)), cut_off=CUT_OFF)
    assert any(re.search(named, problem) for problem in fit.problems), fit.problems


def test_too_little_motion_of_an_engine_is_named() -> None:
    measured, whole = machine("five_bar", "mujoco")
    records = with_noise(measured, 1)
    fit = identify(
        measured.given, part_of(records, slice(0, 130), records.effort, records.carrier_force), cut_off=CUT_OFF
    )  # half a second
    assert any("more motion is needed" in problem for problem in fit.problems)
    assert not any("more motion is needed" in problem for problem in whole.problems)


# --- through a type II singularity -----------------------------------------------------------------------------------


def test_the_singular_stretch_shows_more_than_others_of_the_same_length() -> None:
    """The 2-RPR through its singular line, moved by MuJoCo: as many samples are left out there, and elsewhere.

    Without a tenth of the samples standard deviations grow by 12 % where it is singular, by 6 % elsewhere (median).
    """
    pytest.importorskip("mujoco")
    drive = prepare(SHORT, rp.RneaDynamics)
    true, run = drive.task.robot, run_mujoco(drive.task, step=1e-3)
    given = zoo.robot_of(SHORT.robot, **{**SHORT.arguments, "end_effector_mass": 1.3, "carrier_mass": 2.0})
    effort = np.array(drive.task.efforts(run.t))
    noise = 0.05 * effort.std(axis=0)
    effort += noise * np.random.default_rng(3).standard_normal(effort.shape)
    records = Records(run.t, effort[:, : true.m], platform=run.x, carriers=run.s, carrier_force=effort[:, true.m :])
    fit = identify(given, records, cut_off=20.0, parameters=["mass of *", "moment [xy] of *"])
    assert np.abs((fit.values - true_values(fit, true)) / fit.standard_deviation).max() < 4.0

    motion, carriers = drive.platform(run.t), drive.carriers(run.t)
    along = rp.RneaDynamics(true).along(motion)
    chosen = [fit.base.parameters[k] for k in fit.base.independent]
    Y, W = chain_regressor(along, chosen, carriers), along.tree.W
    E = np.zeros((len(W), true.n + true.k, true.m + true.k))
    E[:, : true.n, : true.m], E[:, true.n :, true.m :] = W, np.eye(true.k)
    covariance = E @ (noise[:, None] ** 2 * E.transpose(0, 2, 1))
    covariance += 1e-4 * np.diag(np.diagonal(covariance.mean(axis=0)))  # where W is singular
    each = Y.transpose(0, 2, 1) @ np.linalg.solve(covariance, Y)  # information of each sample, one noise for all
    margin = np.linalg.svd(W, compute_uv=False)[:, -1]
    middle, half = int(margin.argmin()), 30
    assert margin[middle] < 1e-2 * margin.max()

    def lost(centre: int) -> float:
        """Return by how much standard deviations grow, as a geometric mean, without a window of 60 samples."""
        rest = each.sum(axis=0) - each[centre - half : centre + half].sum(axis=0)
        before, after = (np.diagonal(np.linalg.inv(part)) for part in (each.sum(axis=0), rest))
        return float(np.exp(0.5 * np.log(after / before).mean()))

    others = [lost(centre) for centre in range(half, len(run.t) - half, 10) if abs(centre - middle) > 2 * half]
    assert lost(middle) > np.quantile(others, 0.75)


# --- an open chain, the way of serial arms ---------------------------------------------------------------------------


def arm() -> Robot:
    """Return two links in a vertical plane."""
    model = pin.Model()
    for k, name in enumerate(("shoulder", "elbow")):
        place = pin.SE3(np.eye(3), np.array([0.5 * k, 0.0, 0.0]))
        joint = model.addJoint(k, pin.JointModelRZ(), place, name)
        model.appendBodyToJoint(
            joint,
            pin.Inertia(1.5 - 0.5 * k, np.array([0.2, 0.03, 0.0]), np.diag([0.02, 0.03, 0.04])),
            pin.SE3.Identity(),
        )
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    return rp.robot_from_model(
        model, closures=(), actuated=("shoulder", "elbow"), independent={"joints": ("shoulder", "elbow")}
    )


def test_an_open_chain_is_identified_as_well_as_by_the_way_of_serial_arms() -> None:
    """Splines, Pinocchio's regressor and least squares, as toolboxes for arms do: same parameters, no larger errors."""
    robot, rng = arm(), np.random.default_rng(0)
    t = np.arange(0.0, 4.0, 0.004)
    angle = t[:, None, None] * 2.0 * np.pi * np.array([[0.4, 0.9], [0.7, 1.3]])
    w = 2.0 * np.pi * np.array([[0.4, 0.9], [0.7, 1.3]])
    q = (0.6 * np.sin(angle)).sum(axis=1)
    v, a = (0.6 * w * np.cos(angle)).sum(axis=1), -(0.6 * w**2 * np.sin(angle)).sum(axis=1)
    model, data = robot.model, robot.model.createData()
    tau = np.array([pin.rnea(model, data, *row) for row in zip(q, v, a, strict=True)])
    patterns = ["mass of *", "moment*", "inertia*"]
    errors: dict[str, list[float]] = {"ours": [], "serial": []}
    for _ in range(5):
        effort = tau + 0.05 * tau.std(axis=0) * rng.standard_normal(tau.shape)
        position = np.round(q * 2.0**17 / (2.0 * np.pi)) * 2.0 * np.pi / 2.0**17
        fit = identify(robot, Records(t, effort, position), cut_off=CUT_OFF, parameters=patterns)
        true = true_values(fit, robot)
        assert np.abs((fit.values - true) / fit.standard_deviation).max() < 4.0
        knots = np.concatenate([[t[0]] * 5, np.linspace(t[0], t[-1], int(4.0 * 2.0 * CUT_OFF)), [t[-1]] * 5])
        spline = make_lsq_spline(t, position, knots, 5)
        inside = (t > 0.125) & (t < t[-1] - 0.125)
        rows = zip(*(spline(t[inside], order) for order in range(3)), strict=True)
        Y = np.concatenate([pin.computeJointTorqueRegressor(model, data, *row) for row in rows])
        weights = np.tile(1.0 / tau.std(axis=0), int(inside.sum()))
        found = np.linalg.lstsq(Y * weights[:, None], effort[inside].ravel() * weights, rcond=1e-9)[0]
        columns = [10 * (p.joint - 1) + INERTIAL.index(p.kind) for p in fit.base.parameters]
        serial = fit.base.combination @ found[columns]
        errors["ours"] += ((fit.values - true) / fit.standard_deviation).tolist()
        errors["serial"] += ((serial - true) / fit.standard_deviation).tolist()
        assert np.abs(serial - fit.values).max() < 0.02 * np.abs(true).max()
    ours, theirs = (np.sqrt(np.mean(np.square(each))) for each in errors.values())
    assert ours < 1.1 * theirs
    assert 0.5 < ours < 1.5
