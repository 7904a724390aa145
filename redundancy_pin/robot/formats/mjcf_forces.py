"""Forces of MJCF: friction and springs of joints, rotors, what bounds an actuator; and which are not in force."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import shown
from redundancy_pin.robot.formats.mechanism import NOT_IN_FORCE
from redundancy_pin.robot.formats.mjcf_file import Part
from redundancy_pin.robot.loads import JointForces

_FORCES = {
    "damping": {"damper"},
    "frictionloss": {"frictionloss"},
    "stiffness": {"spring"},
    "springdamper": {"spring", "damper"},
}
"""Attributes of joints, and the flags that disable what they give."""

_OF_TENDONS = (
    "stiffness",
    "damping",
    "frictionloss",
    "limited",
    "range",
    "springlength",
    "armature",
    "actuatorfrcrange",
)


@dataclass
class Forces:
    """What is gathered of forces on the way through a file.

    Attributes:
        disabled: flags of the model that are disabled.
        loads: in force, of joints.
        ranges: least and largest effort (2,) by joint, N or N·m, of joints that bound what all their actuators do.
        armature: by joint, kg·m² or kg.
        left_out: names of what has a force that is not in force, by what it is.
    """

    disabled: set[str]
    loads: list[JointForces] = field(default_factory=list)
    ranges: dict[str, Array] = field(default_factory=dict)
    armature: dict[str, float] = field(default_factory=dict)
    left_out: dict[str, list[str]] = field(default_factory=dict)

    def read(self, part: Part, name: str, kind: str) -> None:
        """Take friction and spring of a hinge or slide and damping of a ball over; other joints and laws are noted."""
        given = {key: part.numbers(key, 1, 9) for key in _FORCES if part.tag != "freejoint" and part.has(key)}
        law = part.numbers("springdamper", 2) if "springdamper" in given else np.zeros(2)
        if law.any():
            if not (law > 0.0).all():
                part.refuse(f"{part} has springdamper={shown(part.text('springdamper'))}", "Both must be positive.")
            # it replaces both, by values that follow from the inertia of the whole model: neither is in force here
            given = {key: value for key, value in given.items() if key not in ("stiffness", "damping")}
        given = {key: value for key, value in given.items() if not _FORCES[key] <= self.disabled}
        values = {}
        for key, numbers in given.items():
            kinds = ("hinge", "slide", "ball") if key == "damping" else ("hinge", "slide")
            if kind in kinds and key != "springdamper" and not numbers[1:].any() and numbers[0] >= 0.0:
                values[key] = float(numbers[0])
            elif numbers.any():
                self.left_out.setdefault(key, []).append(name)
        if any(values.values()):
            unit = math.pi / 180.0 if kind == "hinge" and part.settings.degrees else 1.0
            rest = unit * part.number("springref", 0.0)
            damping, friction, stiffness = (values.get(key, 0.0) for key in ("damping", "frictionloss", "stiffness"))
            self.loads.append(JointForces(name, damping, friction, stiffness=stiffness, rest=rest))

    def read_tendon(self, part: Part) -> None:
        """Note a tendon that pulls."""
        if any(part.has(key) for key in _OF_TENDONS):
            self.left_out.setdefault("tendons", []).append(part.name or f"line {part.element.line}")

    def notes(self, colliding: bool) -> list[str]:
        """Return what is in force and what is not, in words."""
        notes = []
        if listed := "; ".join(f"{what} of {', '.join(names)}" for what, names in self.left_out.items()):
            notes.append(f"{NOT_IN_FORCE} {listed}.")
        if colliding:
            notes.append("Contacts between geoms are not modelled.")
        if disabled := sorted(self.disabled & set().union(*_FORCES.values())):
            notes.append(f"Disabled by flags of the model: {', '.join(disabled)}.")
        if self.loads:
            notes.append(f"In force: damping, friction and springs of {', '.join(load.joint for load in self.loads)}.")
        if self.armature:
            notes.append(f"In force: armature of {', '.join(self.armature)}.")
        return notes


_SERVOS = ("position", "velocity", "intvelocity")
_LAWS = {
    "dyntype": ("none", "integrator", "filter", "filterexact"),
    "gaintype": ("fixed", "affine"),
    "biastype": ("none", "affine"),
}
"""What the force of an actuator may follow from; muscles, motors with a circuit of their own and plugins are others."""


def forces_of(part: Part) -> tuple[Array, bool]:
    """Return the least and largest effort (2,) of an actuator on its joint, N or N·m; and whether it is a servo.

    The effort is infinite if not bounded. Servos have a law of position or speed, which leaves their controls without
    units of force. Other forces are gain · input + bias; the input is the control, or an activation that follows it: of
    a filter within its range too, of an integrator anywhere, but where the activation itself has a range.
    """
    gear, ends = float(part.numbers("gear", 1, 6, default="1")[0]), np.array([-math.inf, math.inf])
    if not gear:
        part.refuse(f"{part} has a gear of zero")
    gain, bias, dynamics, servo = 1.0, 0.0, "none", part.tag in _SERVOS
    if part.tag == "general":
        remedy = "Make it a motor, position or velocity."
        for key, known in _LAWS.items():
            if (law := part.text(key, known[0])) not in known:
                part.refuse(f"{part} has {key}={shown(law)}, which is not covered", remedy)
        dynamics = part.text("dyntype", "none")
        factors, terms = part.numbers("gainprm", 1, 10, default="1"), part.numbers("biasprm", 1, 10, default="0")
        factors = factors[: 1 if part.text("gaintype", "fixed") == "fixed" else 3]
        terms = terms[: 0 if part.text("biastype", "none") == "none" else 3]
        servo = bool(factors[1:].any() or terms[1:].any())
        gain, bias = float(factors[0]), float(terms[:1].sum())
    if not servo:
        if dynamics != "integrator" and part.limited("ctrllimited", "ctrlrange"):
            ends = part.numbers("ctrlrange", 2)
        if dynamics != "none" and part.limited("actlimited", "actrange"):
            ends = ends.clip(*part.numbers("actrange", 2))
        ends = (gain * ends if gain else np.zeros(2)) + bias
    if part.limited("forcelimited", "forcerange"):
        ends = ends.clip(*part.numbers("forcerange", 2))
    return np.sort(gear * ends), servo
