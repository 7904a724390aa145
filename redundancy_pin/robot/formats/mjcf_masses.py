"""Masses and shapes of MJCF's bodies: their inertial element, or the solids that their geoms are."""

from __future__ import annotations

import math

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.robot.formats.mechanism import LinkEntry, angles, combined_mass, moved_to
from redundancy_pin.robot.formats.mjcf_file import ORIENTATION, Part, from_z
from redundancy_pin.robot.loop_joints import placed

POSE = ("pos", *ORIENTATION)


def body_mass(part: Part, name: str, own: list[tuple[Part, Array]]) -> LinkEntry:
    """Return the mass of a body: its inertial element, or what its geoms add up to.

    Args:
        part: the body.
        name: of its link.
        own: its elements, each with the frame (4, 4) that it is written in.
    """
    inertials = [each for each in own if each[0].tag == "inertial"]
    if len(inertials) > 1:
        inertials[1][0].refuse(f"{part} has two inertials")
    rule = part.settings.inertia_from_geom
    if inertials and rule != "true":
        return _inertial(*inertials[0])
    if rule == "false":
        return LinkEntry(name, 0.0, np.zeros(3), np.zeros((3, 3)))
    low, high = part.settings.inertia_groups
    geoms = [each for each in own if each[0].tag == "geom"]
    counted = [(geom, within) for geom, within in geoms if low <= geom.number("group", 0.0) <= high]
    return combined_mass(name, [_of_geom(geom, within) for geom, within in counted])


def shape_of(geom: Part, within: Array) -> str:
    """Return the shape of a geom as a URDF has it; empty for those without a plain one."""
    kind, size = geom.text("type", "sphere"), _sizes(geom)
    forms = {
        "box": ("box", {"size": " ".join(repr(2.0 * s) for s in size[:3])}),
        "sphere": ("sphere", {"radius": repr(size[0]) if size else "0"}),
        "cylinder": ("cylinder", {"radius": repr(size[0]), "length": repr(2.0 * size[1])} if len(size) > 1 else {}),
        "capsule": ("capsule", {"radius": repr(size[0]), "length": repr(2.0 * size[1])} if len(size) > 1 else {}),
    }
    if kind not in forms or not size:
        return ""
    place = within @ place_of_geom(geom)
    yaw, pitch, roll = angles(place[:3, :3])
    shape, attributes = forms[kind]
    text = " ".join(f'{key}="{value}"' for key, value in attributes.items())
    return (
        f'<visual><origin xyz="{" ".join(map(repr, place[:3, 3].tolist()))}" rpy="{roll!r} {pitch!r} {yaw!r}"/>'
        f"<geometry><{shape} {text}/></geometry></visual>\n"
    )


def _inertial(part: Part, within: Array) -> LinkEntry:
    part.require_known((*POSE, "mass", "diaginertia", "fullinertia"))
    if not part.has("pos") or not part.has("mass"):
        part.refuse("an inertial without pos or mass")
    mass = part.number("mass", 0.0)
    if part.has("fullinertia"):
        if any(part.has(key) for key in (*ORIENTATION, "diaginertia")):
            part.refuse("an inertial with fullinertia and an orientation or diaginertia", "Give one of them.")
        xx, yy, zz, xy, xz, yz = part.numbers("fullinertia", 6)
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        turn = part.orientation()
        inertia = turn @ np.diag(part.numbers("diaginertia", 3, default="0 0 0")) @ turn.T
    moments = np.linalg.eigvalsh(inertia)
    if mass < 0.0 or moments[0] < -1e-12 or moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-6) + 1e-12:
        part.refuse(f"an inertial with the mass {mass:g} and the moments {moments}, which no body has", "Correct it.")
    return moved_to(within, LinkEntry("", mass, part.numbers("pos", 3), inertia))


def _sizes(geom: Part) -> list[float]:
    """Return the sizes of a geom; with fromto, radius or sides and half the length."""
    size = geom.numbers("size", 0, 3).tolist() if geom.has("size") else []
    if geom.has("fromto"):
        ends = geom.numbers("fromto", 6)
        half = 0.5 * float(np.linalg.norm(ends[3:] - ends[:3]))
        kind = geom.text("type", "sphere")
        return [*size[:1], half] if kind in ("capsule", "cylinder") else [size[0], size[0], half] if size else []
    return [float(each) for each in size]


def place_of_geom(geom: Part) -> Array:
    """Return the (4, 4) placement of a geom or site in the frame it is written in."""
    if not geom.has("fromto"):
        return geom.placement()
    ends = geom.numbers("fromto", 6)
    along = ends[:3] - ends[3:]  # MuJoCo's z axis points from the second end to the first
    if not np.linalg.norm(along) > 1e-12:
        geom.refuse(f"{geom} has a fromto of length zero")
    return placed(from_z(along), 0.5 * (ends[:3] + ends[3:]))


def _of_geom(geom: Part, within: Array) -> LinkEntry:
    """Return the mass of a geom in the frame of its body."""
    kind = geom.text("type", "mesh" if geom.has("mesh") else "sphere")
    nothing = LinkEntry("", 0.0, np.zeros(3), np.zeros((3, 3)))
    given = geom.number("mass", 0.0) if geom.has("mass") else None
    if kind in ("plane", "hfield") or given == 0.0 or (given is None and geom.number("density", 1000.0) == 0.0):
        return nothing
    if kind not in ("sphere", "box", "capsule", "cylinder", "ellipsoid") or geom.has("mesh"):
        remedy = "Give the body an <inertial>, or the geom a mass of zero."
        geom.refuse(f"{geom} is a {kind} whose mass would have to be computed from its surface", remedy)
    if geom.text("shellinertia", "false") != "false":
        geom.refuse(f"{geom} has shellinertia, which is not covered", "Give the body an <inertial>.")
    size = _sizes(geom)
    if len(size) < {"sphere": 1, "capsule": 2, "cylinder": 2}.get(kind, 3) or any(each <= 0.0 for each in size[:1]):
        geom.refuse(f"{geom} is a {kind} with the size {size}", "Correct it.")
    volume, per_mass = _solid(kind, size)
    mass = geom.number("density", 1000.0) * volume if given is None else given
    if not mass >= 0.0:
        geom.refuse(f"{geom} has the mass {mass:g}")
    place = within @ place_of_geom(geom)
    return moved_to(place, LinkEntry("", mass, np.zeros(3), mass * np.diag(per_mass)))


def _solid(kind: str, size: list[float]) -> tuple[float, list[float]]:
    """Return the volume of a solid, and its moments of inertia per mass, about its centre, the axis along z."""
    a = size[0]
    if kind == "sphere":
        return 4.0 / 3.0 * math.pi * a**3, [0.4 * a * a] * 3
    b = size[1]
    if kind == "cylinder":
        across = (3.0 * a * a + 4.0 * b * b) / 12.0
        return 2.0 * math.pi * a * a * b, [across, across, 0.5 * a * a]
    if kind == "capsule":
        height, ball, tube = 2.0 * b, 4.0 / 3.0 * a, 2.0 * b  # volumes over pi a²
        share = ball / (ball + tube)
        along = (1.0 - share) * 0.5 * a * a + share * 0.4 * a * a
        # each half ball is 3/8 a beyond the end of the tube
        halves = 0.4 * a * a + 0.25 * height * height + 0.375 * height * a
        across = (1.0 - share) * (3.0 * a * a + height * height) / 12.0 + share * halves
        return math.pi * a * a * (ball + tube), [across, across, along]
    c = size[2]
    squares = [b * b + c * c, a * a + c * c, a * a + b * b]
    if kind == "box":
        return 8.0 * a * b * c, [each / 3.0 for each in squares]
    return 4.0 / 3.0 * math.pi * a * b * c, [each / 5.0 for each in squares]
