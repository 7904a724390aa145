"""Backend against backend: Pinocchio's RNEA on the tree, and virtual work by hand."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from redundancy_pin.arrays import Array
from redundancy_pin.crosscheck.cases import Case
from redundancy_pin.crosscheck.report import Tally, relative
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.dynamics.virtual_work import VirtualWork
from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.kinematics.coordinates import row_scale
from redundancy_pin.motion import PlatformMotion

PARITY = 1e-10
"""Rounding through two different routes: about 1e-14 times the condition of the closures, at most 1e3 here."""

AWAY_FROM_TYPE_ONE = 0.05


def check_parity(tally: Tally, case: Case) -> None:
    """Compare f, W, carrier forces, their derivatives, base wrench and energy of both backends on random states."""
    motion, carriers = case.motion(case.t), case.carriers(case.t)
    rnea = RneaDynamics(case.robot).along(motion)
    manual = VirtualWork(case.robot).along(motion)
    keep = rnea.tree.serial_margin_bound > AWAY_FROM_TYPE_ONE
    name = case.robot.name
    first, second = rnea.reduce(carriers), manual.reduce(carriers)
    for label, a, b in (
        ("f", first.f, second.f),
        ("W", first.W, second.W),
        ("carrier force", first.carrier_force, second.carrier_force),
        ("base wrench", rnea.base_wrench(carriers), manual.base_wrench(carriers)),
        ("energy", rnea.energy(carriers)[:, None], manual.energy(carriers)[:, None]),
    ):
        tally.add(name, f"parity: {label}", relative(a[keep], b[keep]), PARITY)
    derivatives = rnea.carrier_derivatives(carriers), manual.carrier_derivatives(carriers)
    for block in ("f", "force"):
        a, b = (
            np.concatenate([getattr(d, f"{block}_{argument}")[keep] for argument in ("s", "sd", "sdd")], axis=2)
            for d in derivatives
        )
        tally.add(
            name, f"parity: derivatives of {'carrier ' if block == 'force' else ''}{block}", relative(a, b), PARITY
        )


def check_parity_on_singularities(tally: Tally, case: Case) -> None:
    """Compare f on poses where W has lost rank, found by root finding along lines between the states of the case."""
    poses = _singular_poses(case)[: len(case.t)]
    if len(poses) == 0:
        return
    count = len(poses)
    motion = case.motion(case.t[:count])
    carriers = case.carriers(case.t[:count])
    for k in range(count):
        # one sample each: singular poses of one case do not lie on one path
        here = PlatformMotion(motion.t[k : k + 1], poses[k : k + 1], motion.xd[k : k + 1], motion.xdd[k : k + 1])
        try:
            rnea = RneaDynamics(case.robot).along(here)
        except RedundancyPinError:
            continue  # not reached from the reference without crossing type I
        if rnea.tree.serial_margin_bound[0] < AWAY_FROM_TYPE_ONE:
            continue
        first = rnea.reduce(carriers[k : k + 1])
        second = VirtualWork(case.robot).along(here).reduce(carriers[k : k + 1])
        singular = np.linalg.svd(first.W[0], compute_uv=False)
        if singular[-1] < 1e-9 * singular[0]:
            tally.add(case.robot.name, "parity: f at type II poses", relative(first.f, second.f), PARITY)
            tally.add(
                case.robot.name,
                "parity: carrier force at type II poses",
                relative(first.carrier_force, second.carrier_force),
                PARITY,
            )


def _singular_poses(case: Case, wanted: int = 8) -> Array:
    """Return type II poses (P, n) on chords between states, from the closed form's determinant."""
    manual: Dynamics = VirtualWork(case.robot)
    rng = np.random.default_rng(len(case.t))
    reach = 1.5 * case.robot.characteristic_length / row_scale(case.robot)
    ends = case.path.mean + rng.uniform(-1.0, 1.0, (200, 2, case.robot.n)) * reach

    def determinant(x: Array) -> Array:
        zero = np.zeros_like(x)
        w = manual.along(PlatformMotion(np.arange(len(x), dtype=float), x, zero, zero), unreachable="mark")
        with np.errstate(invalid="ignore"):  # NaN marks poses out of reach
            value: Array = np.linalg.det(w.reduce().W)
        return value

    found = []
    values = np.stack([determinant(ends[:, 0]), determinant(ends[:, 1])])
    for start, stop, (a, b) in zip(ends[:, 0], ends[:, 1], values.T, strict=True):
        if not (np.isfinite(a) and np.isfinite(b) and a * b < 0.0):
            continue

        def along(u: float, start: Array = start, stop: Array = stop) -> float:
            return float(determinant((start + u * (stop - start))[None])[0])

        try:
            u = brentq(along, 0.0, 1.0, xtol=1e-15, rtol=8.9e-16)
        except (ValueError, RuntimeError):
            continue  # the chord leaves the workspace, or jumps through a pole
        if abs(along(u)) < 1e-10 * max(abs(a), abs(b)):
            found.append(start + u * (stop - start))
        if len(found) == wanted:
            break
    return np.array(found).reshape(len(found), case.robot.n)
