"""A mechanism out of the tree of a URDF, some of its joints replaced: balls, universal joints, a base that moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import DeclarationError, did_you_mean, shown
from redundancy_pin.robot.formats.mechanism import UNLIMITED, Mechanism, six_joints
from redundancy_pin.robot.formats.urdf_tree import JointEntry, LinkEntry, Tree
from redundancy_pin.robot.loads import JointForces
from redundancy_pin.robot.types import Closure

KINDS = ("ball", "fixed", *(f"universal_{one}{two}" for one in "xyz" for two in "xyz" if one != two))
"""What a joint can be replaced by; a universal joint turns about the first axis of its frame, then the second."""


def tree_mechanism(
    tree: Tree,
    name: str,
    *,
    kinds: Mapping[str, str],
    closures: tuple[Closure, ...],
    actuated: tuple[str, ...],
    base: str = "fixed",
    shapes: str = "",
) -> Mechanism:
    """Return what a URDF describes, its joints as independent joints have to be: of one freedom each, or balls.

    A floating joint is three slides and three hinges, a planar one two slides and a hinge; a continuous joint counts
    its turns.

    Args:
        tree: of the URDF.
        name: of the mechanism.
        kinds: by joint, what it is replaced by, one of ``KINDS``.
        closures: what closes the loops.
        actuated: names of driven joints; of a replaced one those that it is made of.
        base: "free" to let the root move, by six joints.
        shapes: URDF that it is drawn from.

    Raises:
        DeclarationError: an unknown joint or kind; a joint that is driven and has several freedoms.
    """
    named = {joint.name: joint for joint in tree.joints}
    for replaced, kind in kinds.items():
        if replaced not in named:
            remedy = f"{did_you_mean(replaced, named)}It has: {', '.join(named)}."
            raise DeclarationError(f"The URDF has no joint {replaced!r}.", remedy=remedy, name=replaced)
        if kind not in KINDS:
            remedy = f"{did_you_mean(kind, KINDS)}There are: {', '.join(KINDS)}."
            raise DeclarationError(
                f"The joint {replaced!r} cannot be made {shown(kind)}.", remedy=remedy, name=replaced
            )
    links: dict[str, LinkEntry] = {}
    joints: list[JointEntry] = []
    start: dict[str, float | Array] = {}

    def added(made: list[JointEntry]) -> None:
        for joint in made:
            links.setdefault(joint.child, tree.links.get(joint.child) or _massless(joint.child))
            joints.append(joint)

    if base == "free":
        links["world"] = _massless("world")
        made, place = six_joints(tree.root, "world", tree.root, np.eye(4))
        start |= place
        added(made)
    else:
        links[tree.root] = tree.links[tree.root]
    single: set[str] = set()
    for joint in tree.joints:
        kind = kinds.get(joint.name, joint.kind)
        if kind == "floating":
            made, place = six_joints(joint.name, joint.parent, joint.child, joint.placement)
            start |= place
        elif kind == "planar" or kind.startswith("universal_"):
            axes = ("x", "y", "rz") if kind == "planar" else tuple(f"r{axis}" for axis in kind[-2:])
            made = _row(joint, axes)
        else:
            kind = "revolute" if kind == "continuous" else kind
            made = [replace(joint, kind=kind, limits=range_of(joint), mimic=None)]
            if kind in ("revolute", "prismatic"):
                single.add(joint.name)
        added(made)
    forces = [JointForces(joint.name, **joint.dynamics) for joint in tree.joints if joint.dynamics]
    return Mechanism(
        name,
        links,
        tuple(joints),
        closures,
        actuated,
        np.array([0.0, 0.0, -9.81]),
        start,
        forces=tuple(load for load in forces if load.joint in single),
        couplings=tuple(each for each in tree.couplings if {each.joint, each.of} <= single),
        shapes=shapes,
    )


def _massless(name: str) -> LinkEntry:
    return LinkEntry(name, 0.0, np.zeros(3), np.zeros((3, 3)))


def _row(joint: JointEntry, axes: tuple[str, ...]) -> list[JointEntry]:
    """Return joints of one freedom in a row, along axes of the joint's frame."""
    made, parent, placement = [], joint.parent, joint.placement
    for axis in axes:
        name, kind = f"{joint.name}_{axis[-1]}", "revolute" if len(axis) == 2 else "prismatic"
        child = joint.child if axis == axes[-1] else f"{name}::link"
        made.append(JointEntry(name, kind, parent, child, placement, np.eye(3)["xyz".index(axis[-1])], UNLIMITED))
        parent, placement = child, np.eye(4)
    return made


def range_of(joint: JointEntry) -> Mapping[str, float]:
    """Return the limits of a joint; none of position where the file gives 0 and 0, or none at all."""
    given = {**UNLIMITED, **{key: value for key, value in joint.limits.items() if key in ("effort", "velocity")}}
    lower, upper = (joint.limits.get(key, 0.0) for key in ("lower", "upper"))
    if joint.kind != "continuous" and lower < upper:
        given |= {"lower": lower, "upper": upper}
    return given
