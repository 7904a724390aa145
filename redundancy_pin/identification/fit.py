"""Identification: the parameters that explain measured motions, their intervals, and what is doubtful about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from redundancy_pin.arrays import Array, Frozen, checked, read_only
from redundancy_pin.errors import InputError
from redundancy_pin.identification.base import BaseParameters, base_parameters
from redundancy_pin.identification.equations import Solution, first_noise, rows_of_records, solve
from redundancy_pin.identification.hints import hints_of_order, hints_of_time
from redundancy_pin.identification.parameters import parameters_of, sensors_of, with_values
from redundancy_pin.identification.physical import nearest_physical, unphysical
from redundancy_pin.identification.records import Records, require_matching, smooth_motion
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.robot import Robot
from redundancy_pin.status import ResultStatus

HALF_INTERVAL = 1.959964
"""Standard deviations, of half a 95 % interval."""

_LEAST = 1e-6
"""Change of the efforts by a parameter of the robot's scale, in standard deviations, that counts as seen."""

_WHITE = 4.0
"""Largest correlation of white residuals from sample to sample, over 1/√N."""

_COLLAPSED = 1e-3
"""Factors of all efforts below which the equations are solved by none at all."""

_EXPLAINED = 0.5
"""Part of the mean square of the measured forces that a model explains, at least."""


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Frozen):
    """Identified parameters; made by ``identify``.

    Attributes:
        status: ``ResultStatus.OK``; ``NOT_CONVERGED`` where the estimates of largest likelihood, or real bodies, were
            not found; ``UNRESOLVED`` where the motion shows no parameter.
        problems: what is doubtful, one text each: parameters without certainty, unphysical ones, residuals that are not
            white, efforts that other signs, another order or other times would explain better. Empty if nothing is.
        before: the robot that was given.
        base: the base parameters of the motion, their names and units.
        values: (b,) their estimates.
        covariance: (b, b) of the estimates, noise of efforts and of positions in it.
        parameters_after: (p,) values of all parameters: the smallest change, relative to their sizes, that gives
            ``values``, or with ``physical`` the nearest of real bodies.
        t: (N,) time of the samples used, s.
        measured: (N, n + k) E u: generalised force of the platform's coordinates, and carrier forces, N and N·m.
        predicted: (N, n + k) the same by the estimates.
        residual: (N, n + k) their difference, whitened: standard normal where the model holds.
        effort_noise: (m,) or (m + k,) standard deviation of the efforts, N or N·m.
        model_noise: (n + k,) standard deviation of what is left out of f.
        position_noise: (m + k,) or (n + k,) standard deviation of the positions about their splines, m and rad.
    """

    status: ResultStatus
    problems: tuple[str, ...]
    before: Robot
    base: BaseParameters
    values: Array
    covariance: Array
    parameters_after: Array
    t: Array
    measured: Array
    predicted: Array
    residual: Array
    effort_noise: Array
    model_noise: Array
    position_noise: Array

    def __repr__(self) -> str:
        """Return the table of the estimates, and the problems."""
        half = self.intervals[:, 1] - self.values
        rows = zip(self.base.names, self.values, half, self.base.units, strict=True)
        lines = [f"{value:12.5g} ± {width:.2g} {unit}: {name}" for name, value, width, unit in rows]
        white = ", ".join(f"{one:.2f}" for one in self.whiteness)
        head = f"Fit of {self.before.name}: {self.status.value}, {len(self.t)} samples, {len(self.base)} parameters"
        lines += (
            [f"not shown by the motion: {len(self.base.unseen)} parameters, base.unseen"] if self.base.unseen else []
        )
        return "\n".join([head, *lines, f"whiteness {white}", *(f"! {problem}" for problem in self.problems)])

    @property
    def standard_deviation(self) -> Array:
        """(b,) of the estimates."""
        return read_only(np.sqrt(np.diagonal(self.covariance)))

    @property
    def intervals(self) -> Array:
        """(b, 2) 95 % intervals."""
        half = HALF_INTERVAL * self.standard_deviation
        return read_only(np.stack([self.values - half, self.values + half], axis=1))

    @property
    def correlation(self) -> Array:
        """(b, b) of the estimates."""
        std = self.standard_deviation
        return read_only(self.covariance / np.outer(std, std))

    @property
    def whiteness(self) -> Array:
        """(n + k,) correlation of the residuals with those one sample before.

        It is within ±1.96/√N where they are white. Where it is larger, by filtered noise or a force that the model does
        not have, the standard deviations are too small by about √((1 + r) / (1 − r)).
        """
        return _whiteness(self.residual)

    @property
    def robot(self) -> Robot:
        """The robot with the estimates; what the motions do not show is as near to the given robot as it can be.

        Raises:
            InputError: a negative friction, damping, stiffness or rotor inertia; ``physical=True`` has none.
        """
        return with_values(self.before, self.base.parameters, self.parameters_after)


def identify(
    robot: RobotLike,
    records: Records | Sequence[Records],
    *,
    cut_off: float,
    parameters: Sequence[str] | None = None,
    sensors: Sequence[str] = (),
    physical: bool = False,
) -> Fit:
    """Return the dynamic parameters of a robot that explain measured motions, with their standard deviations.

    What the motions do not show is regrouped or named; no motion is refused for it. See ``Fit.problems``.

    Args:
        robot: the robot as it is declared, or its name or path; parameters that are not identified keep its values.
        records: one measured motion or several.
        cut_off: Hz, of the splines through the positions: above the fastest motion, below the noise. Efforts are not
            filtered: their noise stays white.
        parameters: names or patterns of the parameters to identify, as of ``parameters_of``.
        sensors: names or patterns of parameters of the effort sensors, as of ``sensors_of``: ``"offset of *"`` and
            ``"factor of *"``, torque constants of currents.
        physical: let ``fit.robot`` have bodies of positive density alone and no negative friction; ``values`` and
            their intervals stay those of the linear fit.

    Raises:
        InputError: records of another robot, with gaps, or with positions that the robot does not reach; a preload
            without stiffness.

    Example:
        >>> fit = identify("five_bar", Records(t, effort, position), cut_off=20.0)
        >>> fit.values, fit.standard_deviation, fit.base.names
    """
    robot = as_robot(robot)
    listed = [records] if isinstance(records, Records) else list(records)
    cut = float(checked(cut_off, "cut_off", ()))
    if cut <= 0.0 or not listed:
        raise InputError(f"cut_off is {cut:g} Hz, of {len(listed)} records.", remedy="Pass records and a positive one.")
    for one in listed:
        require_matching(robot, one)
    for name in ("carrier_force", "platform"):
        if len({getattr(one, name).shape[1] for one in listed}) > 1:
            raise InputError(
                f"Some records have {name} and some have none.",
                remedy="Measure it in all records, or leave it out of all.",
            )
    carried = listed[0].carrier_force.shape[1] > 0
    drives = [*robot.actuated, *robot.carriers][: robot.m + robot.k * carried]
    chosen = (*parameters_of(robot, parameters), *sensors_of(robot, sensors, drives))
    smooth = [smooth_motion(robot, one, cut) for one in listed]
    rows = [rows_of_records(robot, one, part, chosen, carried) for one, part in zip(listed, smooth, strict=True)]
    start = first_noise(rows)
    base = base_parameters(
        np.concatenate([(start.whitening(one.E) @ one.Y).reshape(one.prior.size, -1) for one in rows]),
        chosen,
        _LEAST,
    )
    rows = [replace(one, Y=one.Y[:, :, base.independent]) for one in rows]
    solution = solve(robot, base, rows)
    values = base.combination @ base.standard + solution.change
    standard, converged = base.standard_values(solution.change), solution.converged
    if physical and len(base):
        standard, found = nearest_physical(robot, base, values, solution.information)
        converged = converged and found
    status = ResultStatus.OK if converged else ResultStatus.NOT_CONVERGED
    driven = np.concatenate([one.driven for one in rows])
    problems = _problems(robot, base, standard, solution, driven)
    if len(base):
        problems += [*hints_of_order(robot, rows), *hints_of_time(listed, solution.rows)]
    return Fit(
        status=status if len(base) else ResultStatus.UNRESOLVED,
        problems=tuple(problems),
        before=robot,
        base=base,
        values=read_only(values),
        covariance=read_only(np.linalg.inv(solution.information)),
        parameters_after=read_only(standard),
        t=read_only(np.concatenate([part.motion.t for part in smooth])),
        measured=read_only(driven),
        predicted=read_only(driven - solution.rest),
        residual=read_only(solution.residual),
        effort_noise=read_only(solution.noise.effort),
        model_noise=read_only(solution.noise.model),
        position_noise=read_only(np.max([part.noise for part in smooth], axis=0)),
    )


def _problems(robot: Robot, base: BaseParameters, standard: Array, solution: Solution, driven: Array) -> list[str]:
    """Return what is doubtful about a solution."""
    listed = []
    factors = [k for k, p in enumerate(base.parameters) if p.kind == "factor"]
    if factors and np.abs(standard[factors]).max() < _COLLAPSED:
        listed.append("No known mass or force sets the scale of the factors: leave one out of sensors, or hold masses.")
    half, sizes = HALF_INTERVAL * solution.deviation, base.sizes[base.independent]
    weak = [base.parameters[k].name for k in base.independent[~(half <= sizes)]]
    if weak:
        listed.append(f"Intervals are wider than the robot's scale, more motion is needed: {', '.join(weak)}.")
    bad = unphysical(robot, base, standard)
    if bad:
        listed.append(f"Negative: {', '.join(bad)}. physical=True has none.")
    correlated = _whiteness(solution.residual).max(initial=0.0)
    if correlated > _WHITE / np.sqrt(len(driven)):
        listed.append(
            f"Residuals are correlated from sample to sample by up to {correlated:.2f}: the model lacks a force, "
            "or efforts are filtered; intervals are too narrow."
        )
    total, left = float((driven**2).sum()), float((solution.rest**2).sum())
    if left > (1.0 - _EXPLAINED) * total or not total:
        part = 1.0 - left / total if total else 0.0
        listed.append(f"The model explains {max(part, 0.0):.0%} of the mean square of the measured forces.")
    return listed


def _whiteness(residual: Array) -> Array:
    square = (residual**2).sum(axis=0)
    return read_only((residual[:-1] * residual[1:]).sum(axis=0) / np.where(square, square, 1.0))
