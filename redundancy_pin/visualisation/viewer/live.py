"""A robot under sliders: its loops stay closed while one drags, and the efforts that hold it are shown."""

from __future__ import annotations

import html
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from redundancy_pin.arrays import Array, checked, read_only
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.errors import InputError, SingularPoseError, optional
from redundancy_pin.kinematics.branch import BranchEnd, follower
from redundancy_pin.kinematics.closure import constraint_system
from redundancy_pin.kinematics.coordinates import mode_name, moved, with_independent_joints, working_modes
from redundancy_pin.kinematics.forward_kinematics import followed_motors
from redundancy_pin.robot import Robot
from redundancy_pin.robot.checks import is_pose
from redundancy_pin.robot.lookup import find_joint
from redundancy_pin.robot.types import slides
from redundancy_pin.status import SampleStatus
from redundancy_pin.visualisation.viewer.meshcat_scene import import_meshcat, send_frame, send_scene
from redundancy_pin.visualisation.viewer.scene import Scene, joints_over, make_scene, placements

By = Literal["platform", "actuators"]
"""What the sliders set."""

_STEPS = 400  # of a slider over its range
_REACH = 2.0  # of a slider to either side, in characteristic lengths
_WHY: Mapping[SampleStatus, str] = {
    SampleStatus.UNREACHABLE: "no configuration closes the loops there",
    SampleStatus.TYPE_I: "a singular pose is in the way",
    SampleStatus.BRANCH_LOST: "the loops close there on another branch only",
}


class LiveRobot:
    """A robot in a notebook, moved by sliders, with its loops closed, and its efforts at rest.

    As the last line of a cell it shows itself: sliders and numbers, and the robot in meshcat. Each change
    of a slider is followed along the branch (``Follower.advance``). Where the branch ends, the robot stays at its last
    closed configuration, the sliders return to that configuration, and ``message`` has the reason.

    Attributes:
        robot: the robot.
        sliders: an ``ipywidgets.FloatSlider`` by name for each coordinate of the platform (or each independent joint),
            or each motor, and for each carrier; m and rad. Rotations of a spatial platform are a rotation vector from
            the reference, world axes. Of redundant motors those have sliders that determine the platform best.
        q: (nq,) the configuration that is shown, carriers included; its loops are closed.
        s: (k,) positions of the carriers, m or rad.
        tau: (m,) efforts of the main actuators that hold it at rest, N or N·m; NaN where no finite ones do.
        carrier_force: (k,) efforts of the carriers' actuators, N or N·m.
        status: the ``SampleStatus`` of these efforts.
        margin: distance to type II, the smallest singular value of the scaled W, no unit.
        branch: working mode, such as ``"+-+"``, and the sign of det W, each if it exists.
        message: why the last drag, or a value of the last ``set``, was not followed; empty if it was.

    Example:
        >>> import redundancy_pin as rp
        >>> live = rp.show("five_bar", live=True, by="actuators")
        >>> live.set(left_base=live.sliders["left_base"].value + 0.1)
        >>> live.message
        ''
    """

    def __init__(self, dynamics: Dynamics, by: By = "platform", *, forces: bool = True, height: int = 480) -> None:
        if by not in ("platform", "actuators"):
            raise InputError(f"by is {by!r}.", remedy='Pass by="platform" or by="actuators".')
        self._widgets = optional("ipywidgets", "Sliders need", "Install it with `pip install 'redundancy_pin[live]'`.")
        self.robot = robot = dynamics.robot
        self._dynamics, self._forces, self._height = dynamics, forces, height
        self._driven = robot if by == "platform" else _driven_by_motors(robot)
        self._branch = follower(self._driven)
        self._home = self._state = self._branch.home
        if not np.isfinite(self._home.gamma).all():
            raise SingularPoseError(
                f"The reference of {robot.name} is singular for the {by} as coordinates.",
                remedy='Use the other by=, "platform" or "actuators", or load the robot with another reference.',
            )
        self._viewer: Any = None
        self._window: Any = None  # connection to the meshcat server that ``widget`` started
        self._held, self._numbers = True, self._widgets.HTML()
        ranges = _coordinate_ranges(self._driven, self._home.x)
        self._coordinates, self._start = tuple(ranges), np.array([start for start, _, _ in ranges.values()])
        self._values = self._start
        for name, limits in zip(robot.carriers, robot.carrier_limits, strict=True):
            parked = min(max(0.0, limits.lower), limits.upper)
            ranges[name] = _joint_range(robot, name, parked, limits.lower, limits.upper)
        self.sliders = {name: self._slider(name, *each) for name, each in ranges.items()}
        self._held = False
        self._update()

    def set(self, **values: float) -> None:
        """Set several sliders by name as one drag, m and rad.

        A value beyond the range of its slider sets the slider to the end of the range; ``message`` reports it.

        Raises:
            InputError: a name that no slider has, or a value that is not a finite number.
        """
        unknown = sorted(values.keys() - self.sliders.keys())
        if unknown:
            raise InputError(f"No slider is called {unknown[0]}.", remedy=f"Choose from {', '.join(self.sliders)}.")
        requested = {name: float(checked([value], name, (1,))[0]) for name, value in values.items()}
        self._move_sliders(requested)
        self._update(
            " ".join(
                f"{name} = {value:.4g} is outside [{slider.min:.4g}, {slider.max:.4g}]: set to {slider.value:.4g}."
                for name, value in requested.items()
                if (slider := self.sliders[name]).value != value
            )
        )

    def close(self) -> None:
        """Remove sliders and picture from the notebook, and end the meshcat server that ``widget`` started.

        A viewer that ``send_to`` was given stays open. The last configuration and efforts stay readable.
        """
        self._held, self._viewer = True, None
        for slider in (*self.sliders.values(), self._numbers):
            slider.close()
        if "widget" in vars(self):
            self.widget.close()
        if self._window is not None:
            self._window.zmq_socket.close()
            with self._window.server_proc as server:
                server.kill()
            self._window = None

    def _move_sliders(self, values: Mapping[str, float]) -> None:
        """Set sliders by name without an update."""
        self._held = True
        try:
            for name, value in values.items():
                self.sliders[name].value = value
        finally:
            self._held = False

    @cached_property
    def widget(self) -> Any:
        """Sliders, numbers and the picture, from a meshcat server of this machine."""
        self.send_to(import_meshcat().Visualizer())
        self._window = self._viewer.window
        style = f"width: 100%; height: {self._height}px; border: none"
        picture = self._widgets.HTML(f'<iframe src="{self._viewer.url()}" style="{style}"></iframe>')
        picture.layout.width = "60%"
        return self._widgets.HBox([self._widgets.VBox([*self.sliders.values(), self._numbers]), picture])

    def send_to(self, viewer: Any) -> None:
        """Show the robot in a ``meshcat.Visualizer`` from now on."""
        self._viewer = viewer
        send_scene(viewer, self.scene, forces=self._forces)

    def _repr_mimebundle_(self, **settings: Any) -> Any:
        return self.widget._repr_mimebundle_(**settings)

    @cached_property
    def _first(self) -> Scene:
        """The first picture, again with the first efforts: all later ones have its solids and its scale of efforts."""
        efforts = self.tau[None], self.carrier_force[None]
        return make_scene(
            self.robot, np.zeros(1), self.q[None], np.array([self.margin]), *efforts, title=self.robot.name
        )

    @property
    def scene(self) -> Scene:
        """What is shown, as a scene of one frame."""
        now = joints_over(self.robot, self.q[None], {name: np.array([one]) for name, one in self._efforts().items()})
        joints = tuple(
            replace(joint, per_unit=first.per_unit, longest=self.robot.characteristic_length)
            for joint, first in zip(now, self._first.joints, strict=True)
        )
        placement, margin = placements(self.robot, self.q[None]), np.array([self.margin])
        return replace(self._first, placement=placement, joints=joints, margin=margin)

    def _efforts(self) -> dict[str, float]:
        """Return the effort of each actuator by name, N or N·m; NaN where no finite one holds the robot."""
        names = (*self.robot.actuated, *self.robot.carriers)
        return dict(zip(names, (*self.tau.tolist(), *self.carrier_force.tolist()), strict=True))

    def _slider(self, name: str, start: float, low: float, high: float) -> Any:
        step = (high - low) / _STEPS
        slider = self._widgets.FloatSlider(start, min=low, max=high, step=step, description=name, readout_format=".3f")
        slider.observe(lambda _: self._update(), names="value")
        return slider

    def _update(self, message: str = "") -> None:
        """Follow the branch to the sliders, compute the efforts at rest, and show both; ``message`` is shown first."""
        if self._held:
            return
        values = np.array([self.sliders[name].value for name in self._coordinates])
        end = self._branch.advance(self._state, moved(self._driven, self._home.x, values - self._start))
        if isinstance(end, BranchEnd):
            why = _WHY.get(end.status, end.status.label)
            message += f" Not followed: {why}. The robot stays at the last closed configuration."
            self._move_sliders(dict(zip(self._coordinates, self._values.tolist(), strict=True)))
        else:
            self._state, self._values = end, values
        self.message = message.strip()
        self.s = read_only(np.array([self.sliders[name].value for name in self.robot.carriers]))
        q = np.array(self._state.q)
        q[self.robot.carrier_position] = self.s
        self.q = read_only(q)
        x, still = follower(self.robot).coordinates_at(self._state.q), np.zeros(self.robot.n)
        held = self._dynamics.torque(x, still, still, self.s, start=self._state.q)
        self.tau, self.carrier_force, self.status, self.margin = held.tau, held.carrier_force, held.status, held.margin
        self.branch = _branch_name(self.robot, self._state.q)
        self._numbers.value = self._text()
        if self._viewer is None:
            return
        if not self._first.arrows and np.nansum(np.abs([*self.tau, *self.carrier_force])) > 0.0:
            del self._first  # the efforts were zero so far, and gave the arrows no scale
            self.send_to(self._viewer)
        else:
            send_frame(self._viewer, self.scene, 0)

    def _text(self) -> str:
        """Return message, branch, margin and efforts as HTML."""
        rows = [("margin to type II", f"{self.margin:.3g}, {self.status.label}"), ("branch", self.branch)]
        for name, effort in self._efforts().items():
            unit = "N" if slides(find_joint(self.robot.model, name)) else "N·m"
            rows.append((name, f"{effort:.4g} {unit}" if np.isfinite(effort) else "no finite effort"))
        table = "".join(f"<tr><td>{html.escape(name)}</td><td>{html.escape(text)}</td></tr>" for name, text in rows)
        return f"<b style='color: #B2182B'>{html.escape(self.message)}</b><table>{table}</table>"


def _driven_by_motors(robot: Robot) -> Robot:
    """Return the robot with motors as its coordinates, of redundant ones those that determine the platform best."""
    motors = followed_motors(constraint_system(robot), np.array(robot.q_reference))
    return with_independent_joints(robot, tuple(robot.actuated[i] for i in motors.tolist()))


def _branch_name(robot: Robot, q: Array) -> str:
    """Return working mode and sign of det W at a closed configuration (nq,)."""
    mode = mode_name(tuple(working_modes(robot, q[None])[0].tolist()))
    state = follower(robot).state_at(q)
    square = state is not None and robot.m == robot.n
    sign = float(np.linalg.slogdet(state.W)[0]) if state is not None and square else 0.0
    parts = [f"working mode {mode}"] * bool(mode) + [f"det W {'>' if sign > 0 else '<'} 0"] * bool(sign)
    return ", ".join(parts)


def _coordinate_ranges(robot: Robot, x: Array) -> dict[str, tuple[float, float, float]]:
    """Return where the slider of each independent coordinate starts, and its ends, m and rad."""
    if robot.platform is None:
        limits = robot.model.lowerPositionLimit, robot.model.upperPositionLimit
        joints = [find_joint(robot.model, name) for name in robot.independent_joints]
        ends = [[float(limit[joint.idx_q]) for limit in limits] for joint in joints]
        return {
            name: _joint_range(robot, name, float(start), *(pair if joint.nq == 1 else (-np.inf, np.inf)))
            for name, start, joint, pair in zip(robot.independent_joints, x, joints, ends, strict=True)
        }
    axes, size = robot.platform.axes, robot.characteristic_length
    values = x if not is_pose(robot) else [0.0 if a.startswith("r") else x["xyz".index(a), 3] for a in axes]
    reach = [np.pi if axis.startswith("r") else _REACH * size for axis in axes]
    return {
        axis: (float(value), float(value - away), float(value + away))
        for axis, value, away in zip(axes, values, reach, strict=True)
    }


def _joint_range(robot: Robot, name: str, start: float, low: float, high: float) -> tuple[float, float, float]:
    """Return the start of a joint's slider, and its ends: limits, but half a turn or ``_REACH`` away at most."""
    away = _REACH * robot.characteristic_length if slides(find_joint(robot.model, name)) else np.pi
    return start, min(start, max(low, start - away)), max(start, min(high, start + away))
