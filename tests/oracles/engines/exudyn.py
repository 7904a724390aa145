"""Exudyn: the tree in minimal coordinates, the closures as true constraints, an implicit DAE solver.

The mechanism is one ``ObjectKinematicTree``; every closure is an ``ObjectJointGeneric`` between two markers on it, with
the closure's own mask of axes. The generalised-α method solves the index-3 system: constraints hold at position level
to Newton's tolerance, and the error is of second order in the step. Nothing of Pinocchio and nothing of this package's
dynamics takes part. Links without mass are no trouble as long as the closed mechanism has inertia in every direction
it can move.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from engines.links import GROUND, FrameOnLink, LinkTree, link_tree
from engines.run import EngineRun, Raw, finished, joined, require
from engines.task import Segment, Task, segments
from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError
from redundancy_pin.robot import AXES

SPECTRAL_RADIUS = 0.9
"""Numerical damping of generalised-α at infinite frequency: Exudyn's default. With 1 the multipliers of an index-3
system oscillate from step to step; much smaller values cost accuracy."""

NEWTON_TOLERANCE = 1e-10
"""Relative tolerance of Newton's method. At Exudyn's own 1e-8 the error stops falling near 1e-7 m."""

LEAST_MASS = 1e-12
"""Mass, kg, of links without mass: Exudyn 1.13 divides by that of a chain's last link (docs/tables/engines.md)."""


def run_exudyn(
    task: Task, *, step: float, spectral_radius: float = SPECTRAL_RADIUS, tolerance: float = NEWTON_TOLERANCE
) -> EngineRun:
    """Integrate a task with Exudyn's generalised-α method on the index-3 system.

    Args:
        task: initial state and efforts.
        step: longest step, s; the steps are equal between two breaks.
        spectral_radius: of generalised-α at infinite frequency, 0 to 1.
        tolerance: relative tolerance of Newton's method in each step.

    Returns:
        The motion. Where Newton's method fails the status is ``STOPPED``, with the motion up to there.

    Raises:
        RedundancyPinError: exudyn is not installed.
        UnsupportedRobotError: a joint that is neither revolute nor prismatic.
        InputError: a step, spectral radius or tolerance out of its domain.
    """
    for name, value in (("spectral_radius", spectral_radius), ("tolerance", tolerance)):
        if not 0.0 < value <= 1.0:
            raise InputError(f"{name} is {value}.", remedy="Pass a number above 0 and at most 1.", name=name)
    parts = segments(task, step)
    exu = require("exudyn")
    tree = link_tree(task.robot)
    with _silent(exu):
        system = ExudynSystem(exu, tree)
        system.place(tree.from_q(task.q), tree.from_v(task.v))
        runs: list[Raw] = []
        for part in parts:
            runs.append(system.integrate(part, spectral_radius, tolerance))
            if runs[-1].message:
                break
    raw = joined(runs)
    settings = {"step": max(part.step for part in parts), "spectral_radius": spectral_radius, "tolerance": tolerance}
    return finished(tree, task, raw, "exudyn", str(exu.__version__), settings)


class ExudynSystem:
    """A robot in Exudyn.

    Args:
        exu: the module exudyn.
        tree: the robot.
    """

    def __init__(self, exu: Any, tree: LinkTree) -> None:
        items = require("exudyn.itemInterface")
        self._exu = exu
        self._tree = tree
        count = len(tree.links)
        self._container = exu.SystemContainer()
        self.mbs = self._container.AddSystem()
        zero = [0.0] * count
        node = self.mbs.AddNode(
            items.NodeGenericODE2(
                numberOfODE2Coordinates=count,
                referenceCoordinates=zero,
                initialCoordinates=zero,
                initialCoordinates_t=zero,
            )
        )
        turn, slide = exu.JointType.RevoluteZ, exu.JointType.PrismaticZ
        links = tree.links
        self.object = self.mbs.AddObject(
            items.ObjectKinematicTree(
                nodeNumber=node,
                gravity=tree.gravity.tolist(),
                jointTypes=[turn if link.kind == "revolute" else slide for link in links],
                linkParents=[link.parent for link in links],
                jointTransformations=_list(exu.Matrix3DList(), [link.rotation for link in links]),
                jointOffsets=_list(exu.Vector3DList(), [link.translation for link in links]),
                linkInertiasCOM=_list(exu.Matrix3DList(), [link.inertia for link in links]),
                linkCOMs=_list(exu.Vector3DList(), [link.centre for link in links]),
                linkMasses=[max(link.mass, LEAST_MASS) for link in links],
                jointForceVector=zero,
            )
        )
        ground = self.mbs.AddObject(items.ObjectGround())

        def marker(frame: FrameOnLink) -> Any:
            placement = exu.HT(rotation=frame.rotation, translation=frame.translation)
            if frame.link == GROUND:
                return self.mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=ground, localHT=placement))
            return self.mbs.AddMarker(
                items.MarkerKinematicTreeRigid(objectNumber=self.object, linkNumber=frame.link, localHT=placement)
            )

        self.markers = [(marker(closure.a), marker(closure.b)) for closure in tree.closures]
        for (first, second), closure in zip(self.markers, tree.closures, strict=True):
            if closure.length:
                rod = items.ObjectConnectorDistance(markerNumbers=[first, second], distance=closure.length)
                self.mbs.AddObject(rod)
                continue
            for pair, axes in _joints(first, second, closure.axes):
                mask = [int(axis in axes) for axis in AXES]
                self.mbs.AddObject(items.ObjectJointGeneric(markerNumbers=pair, constrainedAxes=mask))
        self.mbs.Assemble()

    def place(self, coordinates: Array, rates: Array) -> None:
        """Set the initial joint coordinates (links,) and rates (links,)."""
        initial = self._exu.ConfigurationType.Initial
        self.mbs.systemData.SetODE2Coordinates(coordinates, configuration=initial)
        self.mbs.systemData.SetODE2Coordinates_t(rates, configuration=initial)

    def integrate(self, part: Segment, spectral_radius: float, tolerance: float) -> Raw:
        """Integrate one stretch from the initial state; its end becomes the initial state of the next."""
        data, mbs = self.mbs.systemData, self.mbs
        columns = [next(i for i, link in enumerate(self._tree.links) if link.velocity == v) for v in self._tree.driven]
        effort = np.zeros((len(part.t), len(self._tree.links)))
        effort[:, columns] = part.effort
        start = float(part.t[0])
        initial = self._exu.ConfigurationType.Initial
        coordinates = [data.GetODE2Coordinates(configuration=initial)]
        rates = [data.GetODE2Coordinates_t(configuration=initial)]

        def before_step(mbs: Any, t: float) -> bool:
            # t is the end of the step, where generalised-α balances forces; the state is still that of its start
            if t > start + 1.5 * part.step:
                coordinates.append(data.GetODE2Coordinates())
                rates.append(data.GetODE2Coordinates_t())
            mbs.SetObjectParameter(self.object, "jointForceVector", effort[round((t - start) / part.step)])
            return True

        mbs.SetObjectParameter(self.object, "jointForceVector", effort[0])  # for the initial accelerations
        mbs.SetPreStepUserFunction(before_step)
        settings = self._settings(part, spectral_radius, tolerance)
        message = ""
        began = time.perf_counter()
        try:
            done = mbs.SolveDynamic(settings, updateInitialValues=True)
        except Exception as error:  # Exudyn's own types, by version; what failed is a result
            done, message = False, str(error).strip().splitlines()[0]
        seconds = time.perf_counter() - began
        if done:
            coordinates.append(data.GetODE2Coordinates())
            rates.append(data.GetODE2Coordinates_t())
        elif not message:
            message = "Newton's method did not converge."
        reached = part.t[: len(coordinates)]
        if message:
            message = f"Exudyn stopped at {reached[-1]:.6g} s: {message}"
        return Raw(reached, np.array(coordinates), np.array(rates), seconds, message)

    def _settings(self, part: Segment, spectral_radius: float, tolerance: float) -> Any:
        settings = self._exu.SimulationSettings()
        integration = settings.timeIntegration
        integration.startTime, integration.endTime = float(part.t[0]), float(part.t[-1])
        integration.numberOfSteps = len(part.t) - 1
        integration.adaptiveStep = False  # efforts are known at the steps
        integration.verboseMode = 0
        integration.generalizedAlpha.spectralRadius = spectral_radius
        integration.newton.relativeTolerance = tolerance
        integration.newton.absoluteTolerance = tolerance
        settings.solution.file.write = False
        return settings


def _joints(first: Any, second: Any, axes: tuple[str, ...]) -> list[tuple[list[Any], tuple[str, ...]]]:
    """Return the joints of a closure: pairs of markers with the axes they hold.

    A single rotation row is no symmetric matter: rz holds y of one frame normal to x of the other. Here y is of frame
    a (``kinematics.closure`` goes round in a cycle), in Exudyn of the second marker for rx and rz, of the first for ry.
    """
    rotations = tuple(axis for axis in axes if axis.startswith("r"))
    if rotations not in (("rx",), ("rz",)):
        return [([first, second], axes)]
    translations = tuple(axis for axis in axes if not axis.startswith("r"))
    return [([first, second], translations), ([second, first], rotations)]


def _list(target: Any, arrays: Sequence[Array]) -> Any:
    """Fill one of Exudyn's own lists: it takes no list of arrays."""
    for array in arrays:
        target.Append(np.array(array))
    return target


@contextmanager
def _silent(exu: Any) -> Iterator[None]:
    """Keep Exudyn from printing: what failed is in the result."""
    before = exu.config.printToConsole
    exu.config.printToConsole = False
    try:
        yield
    finally:
        exu.config.printToConsole = before
