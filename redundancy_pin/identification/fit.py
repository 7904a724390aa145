"""Identification: parameters that explain measured motions, their intervals, and doubts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from redundancy_pin.arrays import Array, Frozen, checked, read_only
from redundancy_pin.errors import InputError
from redundancy_pin.identification.base import BaseParameters, base_parameters
from redundancy_pin.identification.equations import (
    COLLAPSED,
    Measured,
    Solution,
    linearise,
    measure,
    solve,
    whitening,
)
from redundancy_pin.identification.hints import hints
from redundancy_pin.identification.parameters import IN_JOINT, NOT_NEGATIVE, parameters_of, sensors_of, with_values
from redundancy_pin.identification.physical import nearest_physical, require_whole_bodies, unphysical
from redundancy_pin.identification.records import Records, require_matching, smooth_motion
from redundancy_pin.io.summary import Summary, TextTable
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.robot import Robot
from redundancy_pin.status import ResultStatus

HALF_INTERVAL = 1.959964
"""Standard deviations, of half a 95 % interval."""

_LEAST = 1e-8
"""Norm of the change of all efforts by a parameter of the robot's scale, in the robot's scale, that counts as seen."""

_WHITE = 4.0
"""Largest correlation of white residuals from sample to sample, over 1/√N."""

_DEAD = 1e-9
"""Change of an effort relative to its size below which its sensor is dead."""

_OUTLIER = 100.0
"""Size of an effort relative to that of 99 % of the samples from which it is told."""

_EXPLAINED = 0.5
"""Part of the mean square of the measured forces that a model explains, at least."""


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Frozen):
    """Identified parameters; made by ``identify``.

    Attributes:
        status: ``ResultStatus.OK``; ``NOT_CONVERGED`` where the estimates of largest likelihood, or real bodies, were
            not found; ``UNRESOLVED`` where the motion shows no parameter.
        problems: doubts, one text each: parameters without certainty, unphysical ones, residuals that are not
            white, efforts that other signs, another order or other times would explain better. Empty if nothing is.
        before: the robot that was given.
        base: the base parameters of the motion, their names and units.
        values: (b,) their estimates.
        covariance: (b, b) of the estimates, noise of efforts and of positions in it, white or not.
        parameters_after: (p,) values of all parameters: the smallest change, relative to their sizes, that gives
            ``values``, or with ``physical`` the nearest of real bodies.
        t: (N,) time of the samples used, s.
        measured: (N, n + k) generalised force of the platform's coordinates, and carrier forces, N and N·m, by the
            measured efforts, factors of their sensors in it.
        predicted: (N, n + k) the same by the estimates, offsets of the sensors in it.
        residual: (N, n + k) their difference, whitened, noise of positions taken off.
        effort_noise: (records, m) or (records, m + k) standard deviation of the measured efforts, N or N·m.
        position_noise: (m + k,) or (n + k,) standard deviation of the positions about their splines, m and rad.
        whiteness: (n + k,) correlation of the residuals with those one sample before, less what white noise has in this
            estimation: within ±1.96/√N where noise is white. ``covariance`` allows for the correlation that is found
            within a period of the cut-off.
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
    position_noise: Array
    whiteness: Array

    def __repr__(self) -> str:
        """Return the robot and how many samples, parameters and problems there are."""
        counts = f"{len(self.t)} samples, {len(self.base)} base parameters, {len(self.problems)} problems"
        return f"Fit({self.before.name}: {self.status.value}, {counts})"

    def summary(self) -> Summary:
        """Return values, half widths of 95 % intervals and doubts as plain data, for ``print``.

        Example:
            >>> print(fit.summary())
        """
        half = self.intervals[:, 1] - self.values
        facts = {
            "robot": self.before.name,
            "status": self.status.value,
            "problems": list(self.problems),
            "samples": len(self.t),
            "names": list(self.base.names),
            "units": list(self.base.units),
            "values": self.values,
            "half_intervals": half,
            "unseen": list(self.base.unseen),
            "effort_noise": self.effort_noise,
            "whiteness": self.whiteness,
        }
        estimates = zip(self.base.names, self.values, half, self.base.units, strict=True)
        rows: list[Sequence[str]] = [
            (name, f"{value:.5g} ± {width:.2g} {unit}") for name, value, width, unit in estimates
        ]
        if self.base.unseen:
            rows.append(("not shown by the motion", f"{len(self.base.unseen)} parameters, base.unseen"))
        rows += [("whiteness", ", ".join(f"{one:.2f}" for one in self.whiteness)), ("status", self.status.value)]
        title = f"{self.before.name}: {len(self.t)} samples, {len(self.base)} base parameters, 95 %"
        return Summary(facts, TextTable(title, rows), warnings=self.problems)

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
    def robot(self) -> Robot:
        """The robot with the estimates; what the motions do not show is as near to the given robot as it can be.

        Raises:
            InputError: a negative friction, damping, stiffness or rotor inertia; ``physical=True`` has none.
        """
        listed = zip(self.base.parameters, self.parameters_after.tolist(), strict=True)
        negative = [p.name for p, value in listed if p.kind in IN_JOINT and p.kind in NOT_NEGATIVE and value < 0.0]
        if negative:
            raise InputError(
                f"No robot has what the fit has found, negative: {', '.join(negative)}.",
                remedy="Call identify with physical=True, leave them out of parameters, or check the signs of efforts.",
                names=negative,
            )
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
        sensors: names or patterns of parameters of the measurement, as of ``sensors_of``: ``"factor of *"``, torque
            constants of currents, ``"offset of *"``, with effort = factor · reading − offset, and ``"tilt * of
            gravity"``, rad.
        physical: let ``fit.robot`` have bodies of positive density alone and no negative friction; ``values`` and
            their intervals still belong to the linear fit. Of a body all ten are sought, or its mass alone.

    Raises:
        InputError: records of another robot, with gaps, or with positions that the robot does not reach; a preload
            without stiffness; bodies in part with ``physical``.

    Example:
        >>> from redundancy_pin.identification import Records
        >>> t = np.arange(0.0, 3.0, 0.01)
        >>> x = np.stack([0.25 + 0.1 * np.sin(4.0 * t), 0.7 + 0.05 * np.sin(7.0 * t)], axis=1)
        >>> xd = np.stack([0.4 * np.cos(4.0 * t), 0.35 * np.cos(7.0 * t)], axis=1)
        >>> xdd = np.stack([-1.6 * np.sin(4.0 * t), -2.45 * np.sin(7.0 * t)], axis=1)
        >>> tau = rp.inverse_dynamics("five_bar", rp.PlatformMotion(t, x, xd, xdd)).efforts.tau
        >>> noise = 0.01 * np.random.default_rng(0).standard_normal(tau.shape)
        >>> fit = rp.identify("five_bar", Records(t, tau + noise, platform=x), cut_off=5.0, parameters=["mass of *"])
        >>> len(fit.values) == len(fit.base.names)
        True
    """
    robot = as_robot(robot)
    listed = list(records) if isinstance(records, Sequence) else [records]
    cut = float(checked(cut_off, "cut_off", ()))
    if cut <= 0.0 or not listed or not all(isinstance(one, Records) for one in listed):
        raise InputError(
            f"cut_off is {cut:g} Hz, records are {[type(one).__name__ for one in listed]}.",
            remedy="Pass one Records or several, and a positive cut_off.",
        )
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
    if physical:
        require_whole_bodies(robot, chosen)

    def measured(some: Sequence[Records]) -> list[Measured]:
        return [measure(robot, one, smooth_motion(robot, one, cut), carried) for one in some]

    equations = measured(listed)
    given = np.array([p.value for p in chosen])
    rows = [linearise(one, chosen, given, range(len(chosen))) for one in equations]
    sizes = {p.of: p.size for p in sensors_of(robot, ["offset of *"], drives)}
    scale = np.array([sizes[name] for name in drives])
    weighted = [(whitening(one.record.E, scale) @ one.Y).reshape(one.right.size, len(chosen)) for one in rows]
    base = base_parameters(np.concatenate(weighted), chosen, _LEAST)
    rows = [replace(one, Y=one.Y[:, :, base.independent]) for one in rows]
    t = np.concatenate([one.along.motion.t for one in equations])
    step = float(np.median(np.concatenate([np.diff(one.along.motion.t) for one in equations])))
    try:
        solution = solve(base, equations)
        weight = solution.weight(max(1, round(1.0 / (cut * step))))
        covariance = np.linalg.inv(weight) @ np.linalg.inv(weight).T
    except np.linalg.LinAlgError as error:
        raise InputError(
            f"The equations are lost in rounding. {' '.join(_odd_columns(listed, drives))}",
            remedy="Check the efforts: their units, and readings far from all others.",
        ) from error
    values = base.combination @ base.standard + solution.change
    standard, found = base.standard_values(solution.change), True
    if physical and len(base):
        standard, found = nearest_physical(base, values, weight)
    problems = [*_odd_columns(listed, drives), *_problems(robot, base, standard, solution, covariance)]
    if not found:
        problems.append("The nearest real bodies were not found.")
    if len(base):
        problems += hints(robot, listed, rows, solution, lambda others: solve(base, measured(others)))
    rest = np.concatenate([part.rest for part in solution.parts])
    driven = np.concatenate([part.rows.driven for part in solution.parts])
    status = ResultStatus.OK if solution.converged and found else ResultStatus.NOT_CONVERGED
    return Fit(
        status=status if len(base) else ResultStatus.UNRESOLVED,
        problems=tuple(problems),
        before=robot,
        base=base,
        values=read_only(values),
        covariance=read_only(covariance),
        parameters_after=read_only(standard),
        t=read_only(t),
        measured=read_only(driven),
        predicted=read_only(driven - rest),
        residual=read_only(np.concatenate([part.white for part in solution.parts])),
        effort_noise=read_only(np.array([part.rows.noise for part in solution.parts])),
        position_noise=read_only(np.max([one.smooth.noise for one in equations], axis=0)),
        whiteness=read_only(solution.whiteness),
    )


def _odd_columns(records: Sequence[Records], drives: Sequence[str]) -> list[str]:
    """Return which columns of efforts do not change, and which have one reading far from all others."""
    listed = []
    for r, one in enumerate(records):
        for name, column in zip(drives, np.abs(one.efforts).T, strict=False):
            k, usual = int(column.argmax()), float(np.quantile(column, 0.99))
            if np.ptp(column) <= _DEAD * column[k]:
                listed.append(f"The effort of {name} is the same throughout records[{r}]: its motor or sensor is dead.")
            elif column[k] > _OUTLIER * usual:
                listed.append(
                    f"The effort of {name} has a size of {column[k]:g} at t = {one.t[k]:g} s in records[{r}], and of "
                    f"{usual:g} at most in 99 % of the samples: leave that sample out."
                )
    return listed


def _problems(robot: Robot, base: BaseParameters, standard: Array, solution: Solution, covariance: Array) -> list[str]:
    """Return the doubts about a solution."""
    listed = []
    factors = [k for k, p in enumerate(base.parameters) if p.kind == "factor"]
    if factors and np.abs(standard[factors]).max() < COLLAPSED:
        listed.append("No known mass or force sets the scale of the factors: leave one out of sensors, or hold masses.")
    elif not solution.converged and len(base):
        listed.append("The estimates did not settle: intervals may be wrong; more motion, or fewer parameters.")
    half, sizes = HALF_INTERVAL * np.sqrt(np.diagonal(covariance)), base.sizes[base.independent]
    weak = [base.parameters[k].name for k in base.independent[~(half <= sizes)]]
    if weak:
        listed.append(f"Intervals are wider than the robot's scale, more motion is needed: {', '.join(weak)}.")
    bad = unphysical(robot, base, standard)
    if bad:
        listed.append(
            f"Negative: {', '.join(bad)}. The nearest real bodies have none, where all ten of a body are sought: "
            "physical=True, or --out on the command line."
        )
    white, count = solution.whiteness, sum(len(part.white) for part in solution.parts)
    if np.abs(white).max(initial=0.0) > _WHITE / np.sqrt(count):
        listed.append(
            f"Residuals are correlated from sample to sample by up to {white[np.abs(white).argmax()]:.2f}: the model "
            "lacks a force, efforts are filtered, or noise of positions is not white; estimates may be biased."
        )
    rest = np.concatenate([part.rest for part in solution.parts])
    driven = np.concatenate([part.rows.driven for part in solution.parts])
    total, left = float((driven**2).sum()), float((rest**2).sum())
    if left > (1.0 - _EXPLAINED) * total or not total:
        part = 1.0 - left / total if total else 0.0
        listed.append(f"The model explains {max(part, 0.0):.0%} of the mean square of the measured forces.")
    return listed
