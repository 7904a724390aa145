"""3-RPS and 3-PRS in closed form: the pose that height, roll and pitch leave, and the positions of the actuators.

A ball joint of leg i stays in the plane of that leg, normal to its hinge. The three conditions give yaw, x and y
(Carretero, Podhorodeski, Nahon and Gosselin, "Kinematic analysis and optimization of a new three degree-of-freedom
spatial parallel manipulator", J. Mech. Des. 122, 2000): R[1, 0] = R[0, 1], x = b (R[0, 0] - R[1, 1]) / 2,
y = -b R[1, 0]. The formulas take complex numbers, whose imaginary parts of 1e-30 give exact derivatives.
"""

from __future__ import annotations

from math import cos, sin
from pathlib import Path

import numpy as np
import yaml

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.robot import Robot

AZIMUTHS = 2.0 * np.pi / 3.0 * np.arange(3)
BASE, PLATFORM, HEIGHT, LINK = 0.3, 0.2, 0.5, 0.45
HOME = {"3rps": HEIGHT, "3prs": 0.6}
"""Height of the platform at the reference, m."""
NAMES = tuple(HOME)
NATURAL = ("z", "rx", "ry")
_STEP = 1e-30
_OUTWARD = np.stack([np.cos(AZIMUTHS), np.sin(AZIMUTHS), 0.0 * AZIMUTHS])


def poses(x: Array, size: float = 1.0) -> tuple[Array, Array]:
    """Return rotations (N, 3, 3) and origins (N, 3) of platforms at height, roll and pitch (N, 3)."""
    z, roll, pitch = x.T
    yaw = np.arctan(np.sin(pitch) * np.sin(roll) / (np.cos(pitch) + np.cos(roll)))
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(angle), np.sin(angle)) for angle in (roll, pitch, yaw))
    rotation = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    ).transpose(2, 0, 1)
    b = PLATFORM * size
    origin = np.stack([0.5 * b * (rotation[:, 0, 0] - rotation[:, 1, 1]), -b * rotation[:, 1, 0], z], axis=1)
    return rotation, origin


def actuators(name: str, x: Array, size: float = 1.0, link: float = LINK) -> Array:
    """Return (N, 3) the positions of the actuators: lengths of legs, or heights of slides; NaN out of reach."""
    balls = _balls(x, size)
    if name == "3rps":
        return np.sqrt(((balls - BASE * size * _OUTWARD) ** 2).sum(axis=1))
    with np.errstate(invalid="ignore"):
        return balls[:, 2] - np.sqrt((link * size) ** 2 - _across(x, size) ** 2)


def _balls(x: Array, size: float) -> Array:
    rotation, origin = poses(x, size)
    return origin[:, :, None] + rotation @ (PLATFORM * size * _OUTWARD)


def _across(x: Array, size: float = 1.0) -> Array:
    """Return (N, 3) how far the ball joints are inward of the base circle."""
    return BASE * size - (_balls(x, size) * _OUTWARD).sum(axis=1)


def slopes(name: str, x: Array) -> Array:
    """Return W (N, 3, 3): the derivative of actuator j by coordinate i."""
    parts = [actuators(name, x + 1j * _STEP * np.eye(3)[i]).imag / _STEP for i in range(3)]
    return np.stack(parts, axis=1)


def motion(name: str, t: Array) -> rp.PlatformMotion:
    """Return a motion with large tilts about both axes at once, with exact rates."""
    amplitude, frequency = np.array([0.06, 0.35, 0.45]), np.array([2.0, 3.1, 2.3])
    phase = frequency * t[:, None] + [0.3, 0.7, 1.9]
    x = np.array([HOME[name], 0.0, 0.0]) + amplitude * np.sin(phase)
    xd, xdd = amplitude * frequency * np.cos(phase), -amplitude * frequency**2 * np.sin(phase)
    return rp.PlatformMotion(t, x, xd, xdd)


def coordinates(axes: tuple[str, ...], x: Array) -> Array:
    """Return (N, n) other coordinates of the platform at height, roll and pitch (N, 3)."""
    rotation, origin = poses(x)
    two = sum(axis.startswith("r") for axis in axes) == 2
    ratios = {
        "rx": rotation[:, 2, 1] / (rotation[:, 2, 2] if two else rotation[:, 1, 1]),
        "ry": x[:, 2] if two else rotation[:, 0, 2] / rotation[:, 2, 2],
        "rz": rotation[:, 1, 0] / rotation[:, 0, 0],
    }
    angles = {axis: part if two and axis == "ry" else np.arctan(part) for axis, part in ratios.items()}
    return np.stack([angles[axis] if axis in angles else origin[:, "xyz".index(axis)] for axis in axes], axis=1)


def in_coordinates(axes: tuple[str, ...], name: str, t: Array) -> rp.PlatformMotion:
    """Return the motion ``motion`` in other coordinates; what is differentiated once is good to 1e-9."""
    h = 1e-3
    slope = {step: _slope(axes, motion(name, t + step * h).x) for step in (-2, -1, 0, 1, 2)}
    rate = (slope[-2] - 8.0 * slope[-1] + 8.0 * slope[1] - slope[2]) / (12.0 * h)
    own = motion(name, t)
    xd = np.einsum("nij,nj->ni", slope[0], own.xd)
    xdd = np.einsum("nij,nj->ni", slope[0], own.xdd) + np.einsum("nij,nj->ni", rate, own.xd)
    return rp.PlatformMotion(t, coordinates(axes, own.x), xd, xdd)


def _slope(axes: tuple[str, ...], x: Array) -> Array:
    return np.stack([coordinates(axes, x + 1j * _STEP * each).imag / _STEP for each in np.eye(3)], axis=2)


def robot_called(
    name: str,
    folder: Path,
    size: float = 1.0,
    axes: tuple[str, ...] = NATURAL,
    at: Array | None = None,
    link: float = LINK,
) -> Robot:
    """Return a robot: the 3-RPS that is shipped, or a 3-PRS, whose platform hangs on a ball joint.

    The platform of the latter may have other coordinates ``axes``, and its reference at height, roll and pitch ``at``.
    """
    if name == "3rps":
        return rp.load_robot(name, base_radius=BASE * size, platform_radius=PLATFORM * size, height=HEIGHT * size)
    (folder / "3prs.urdf").write_text(_prs(size, link), encoding="utf-8")
    x = np.array([[HOME["3prs"], 0.0, 0.0]] if at is None else [at])
    place = coordinates(axes, x)[0] * [1.0 if axis.startswith("r") else size for axis in axes]
    swing = -np.arcsin(_across(x)[0] / link)
    guess: dict[str, float] = {}
    for i, (slide, angle) in enumerate(zip(actuators("3prs", x, link=link)[0] * size, swing, strict=True), start=1):
        guess |= {f"slide_{i}": float(slide), f"swing_{i}": float(angle)}
    data = {
        "urdf": "3prs.urdf",
        "gravity": [0, 0, -9.81],
        "joint_types": {"ball": "ball"},
        "closures": [{"frames": [f"corner_{i}", f"tip_{i}"], "axes": ["x", "y", "z"]} for i in (2, 3)],
        "actuated": ["slide_1", "slide_2", "slide_3"],
        "independent": {"platform": "platform", "axes": list(axes)},
        "reference": {"platform": place.tolist(), "guess": guess},
    }
    path = folder / "robot.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return rp.load_robot(path)


def _prs(size: float, link: float) -> str:
    parts = ['<robot name="3prs"><link name="base"/>']
    for i, azimuth in enumerate(AZIMUTHS.tolist(), start=1):
        at = f"{BASE * size * cos(azimuth)!r} {BASE * size * sin(azimuth)!r} 0"
        parts += [
            _joint(f"slide_{i}", "prismatic", "base", f"cart_{i}", "0 0 1", at, f"0 0 {azimuth!r}"),
            _body(f"cart_{i}", 0.8, (0.0, 0.0, 0.0), 1e-3, size),
            _joint(f"swing_{i}", "revolute", f"cart_{i}", f"link_{i}", "0 1 0"),
            _body(f"link_{i}", 0.5, (0.0, 0.0, 0.5 * link), 8e-3, size),
        ]
    parts += [
        _joint("ball", "revolute", "link_1", "corner_1", "0 0 1", f"0 0 {link * size!r}"),
        '<link name="corner_1"/>',
        _joint("plate", "fixed", "corner_1", "platform", "0 0 1", f"{-PLATFORM * size!r} 0 0"),
        _body("platform", 3.0, (0.01, -0.02, 0.03), 2e-2, size),
    ]
    for i, azimuth in enumerate(AZIMUTHS.tolist()[1:], start=2):
        at = f"{PLATFORM * size * cos(azimuth)!r} {PLATFORM * size * sin(azimuth)!r} 0"
        parts += [_joint(f"mount_{i}", "fixed", "platform", f"corner_{i}", "0 0 1", at), f'<link name="corner_{i}"/>']
        parts += [
            _joint(f"end_{i}", "fixed", f"link_{i}", f"tip_{i}", "0 0 1", f"0 0 {link * size!r}"),
            f'<link name="tip_{i}"/>',
        ]
    return "".join([*parts, "</robot>"])


def _joint(name: str, kind: str, parent: str, child: str, axis: str, xyz: str = "0 0 0", rpy: str = "0 0 0") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
        '<limit lower="-1000" upper="1000" velocity="100" effort="1000"/></joint>'
    )


def _body(name: str, mass: float, centre: tuple[float, float, float], moment: float, size: float) -> str:
    place = " ".join(repr(part * size) for part in centre)
    moments = " ".join(
        f'{key}="{moment * size**2 * share!r}"' for key, share in (("ixx", 1), ("iyy", 0.9), ("izz", 0.7))
    )
    return (
        f'<link name="{name}"><inertial><origin xyz="{place}"/><mass value="{mass}"/>'
        f'<inertia {moments} ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
