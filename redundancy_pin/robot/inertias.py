"""Check what the parser of a rendered URDF passes over in silence: broken masses and inertias, coupled joints."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from redundancy_pin.errors import ModelFileError

_MOMENTS = ("ixx", "iyy", "izz")
_PRODUCTS = ("ixy", "ixz", "iyz")

_TRIANGLE_TOLERANCE = 1e-6
"""A moment of inertia may exceed the sum of the other two by this fraction: files carry six digits."""


def require_inertias(path: Path, urdf: str) -> None:
    """Check every ``inertial`` element of a URDF.

    Args:
        path: the file it came from, for messages.
        urdf: the rendered URDF.

    Raises:
        ModelFileError: naming the link whose mass is negative or not a number, or whose inertia no body can have.
    """
    for link in ElementTree.fromstring(urdf).iter("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        name = link.get("name", "?")
        mass = _number(path, name, "mass", inertial.find("mass"), "value")
        if mass < 0.0:
            raise _refuse(path, name, f"a negative mass, {mass:g} kg")
        element = inertial.find("inertia")
        if element is None:
            raise _refuse(path, name, "no inertia")
        xx, yy, zz = (_number(path, name, key, element, key) for key in _MOMENTS)
        xy, xz, yz = (_number(path, name, key, element, key, 0.0) for key in _PRODUCTS)
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        allowed = _TRIANGLE_TOLERANCE * float(np.abs(moments).max())
        if moments[0] < -allowed or moments[2] > moments[0] + moments[1] + allowed:
            raise _refuse(
                path,
                name,
                f"principal moments of inertia {np.array2string(moments, precision=4)} that no body can have",
            )


def require_no_mimics(path: Path, urdf: str) -> None:
    """Check that no joint follows another: the tree would be given a freedom it does not have.

    Raises:
        ModelFileError: naming the joint.
    """
    for joint in ElementTree.fromstring(urdf).iter("joint"):
        if joint.find("mimic") is not None:
            raise ModelFileError(
                f"The joint {joint.get('name')!r} of {path.name} mimics another, which closed chains do not cover.",
                remedy="Build the coupling as a loop, or make the joint free or fixed.",
                path=str(path),
            )


def _number(
    path: Path, link: str, what: str, element: ElementTree.Element | None, key: str, default: float | None = None
) -> float:
    text = None if element is None else element.get(key)
    if text is None and default is not None:
        return default
    try:
        value = float(text) if text is not None else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise _refuse(path, link, f"the {what} {text!r}, which is not a finite number")
    return value


def _refuse(path: Path, link: str, what: str) -> ModelFileError:
    return ModelFileError(
        f"The link {link!r} of {path.name} has {what}.",
        remedy="Correct the URDF, or the xacro arguments it is made from.",
        path=str(path),
        link=link,
    )
