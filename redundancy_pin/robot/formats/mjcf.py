"""Read MJCF, the models of MuJoCo: bodies, joints and sites, the equalities that close loops, what drives the joints.

A subset, read as MuJoCo reads it; what else changes the mechanics is refused by name, file and line. Forces that are
left out (contacts, tendons) are named in the notes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import did_you_mean, shown
from redundancy_pin.robot.formats.mechanism import (
    MOST_FREEDOMS,
    UNLIMITED,
    JointEntry,
    LinkEntry,
    Mechanism,
    angles,
    drawn,
    mechanism_of_tree,
    six_joints,
)
from redundancy_pin.robot.formats.mjcf_file import (
    CompilerSettings,
    Defaults,
    Included,
    Part,
    about,
    from_quaternion,
)
from redundancy_pin.robot.formats.mjcf_forces import Forces, forces_of
from redundancy_pin.robot.formats.mjcf_masses import POSE, body_mass, place_of_geom, shape_of
from redundancy_pin.robot.formats.xml_files import Element
from redundancy_pin.robot.loop_joints import placed
from redundancy_pin.robot.types import AXES, Closure, Coupling

_IGNORED = ("visual", "statistic", "asset", "size", "sensor", "custom", "contact", "default", "keyframe")
"""Sections that move nothing: pictures, measurements, sizes of memory; contacts are named in the notes."""

_SECTIONS = (*_IGNORED, "compiler", "option", "worldbody", "equality", "actuator", "tendon")

_SOLVER = ("solref", "solimp", "margin", "gap")
_OF_JOINT = (
    *("type", "group", "pos", "axis", "range", "limited", "ref", "user", "margin", "springref"),
    *("solreflimit", "solimplimit", "solreffriction", "solimpfriction", "actuatorfrclimited", "actuatorfrcrange"),
    *("stiffness", "damping", "frictionloss", "springdamper", "armature", "actuatorgravcomp"),
)
_OF_GEOM = (
    *(*POSE, *_SOLVER, "type", "size", "fromto", "mass", "density", "group", "rgba", "material", "contype", "user"),
    *("conaffinity", "condim", "priority", "friction", "solmix", "hfield", "mesh", "fitscale", "shellinertia"),
    *("fluidshape", "fluidcoef"),
)
_OF_BODY = (*POSE, "childclass", "mocap", "gravcomp", "user", "sleep")
_OF_SITE = (*POSE, "type", "size", "fromto", "group", "rgba", "material", "user")
_OF_ACTUATOR = (
    *(
        "group",
        "ctrllimited",
        "forcelimited",
        "actlimited",
        "ctrlrange",
        "forcerange",
        "actrange",
        "lengthrange",
        "gear",
    ),
    *("joint", "jointinparent", "user", "dyntype", "gaintype", "biastype", "dynprm", "gainprm", "biasprm", "actearly"),
    *("kp", "kv", "dampratio", "timeconst", "inheritrange", "nsample", "interp", "delay", "actdim"),
)
_NO_JOINT = "Drive a joint: forces along tendons, at sites and on bodies are not covered."
_NO_TRANSMISSION = dict.fromkeys(
    ("tendon", "site", "refsite", "body", "slidersite", "cranksite", "cranklength"), _NO_JOINT
)
_OF_COMPILER = (
    *("angle", "eulerseq", "autolimits", "inertiafromgeom", "inertiagrouprange", "meshdir", "texturedir", "assetdir"),
    *("strippath", "discardvisual", "usethread", "fusestatic", "coordinate", "convexhull", "exactmeshinertia"),
    *("balanceinertia", "boundmass", "boundinertia", "settotalmass", "alignfree", "saveinertial", "fitaabb"),
)
_EQUALITIES = {
    "connect": ("body1", "body2", "site1", "site2", "anchor"),
    "weld": ("body1", "body2", "site1", "site2", "anchor", "relpose", "torquescale"),
    "joint": ("joint1", "joint2", "polycoef"),
}
"""Kinds of equalities, and the attributes that each has."""

_FLAGS = (
    *("constraint", "equality", "frictionloss", "limit", "contact", "spring", "damper", "gravity", "clampctrl"),
    *("warmstart", "filterparent", "actuation", "refsafe", "sensor", "midphase", "eulerdamp", "autoreset"),
    *("nativeccd", "island", "multiccd", "override", "energy", "fwdinv", "invdiscrete", "sleep", "diagexact"),
    *("ipc", "speculative"),
)
"""Those of MuJoCo. Most say how it computes; ranges and drives stay those of the machine, whatever it simulates."""

_SMALLEST = 1e-15
"""MuJoCo's mjMINVAL: a quaternion that is shorter is no turn."""


def read_mjcf(path: Path, *, keyframe: str = "", base: str = "free") -> Mechanism:
    """Read a model of MuJoCo.

    Args:
        path: the file.
        keyframe: name of the keyframe that the mechanism starts from; the initial configuration when empty.
        base: "free", or "fixed" to hold bodies with free joints where they start.

    Raises:
        ModelFileError: naming file and line: a file that is none, or what this reader does not know.
    """
    return _Reader(Included(path), keyframe, base).mechanism()


class _Reader:
    """What is gathered on the way through a file."""

    def __init__(self, files: Included, keyframe: str, base: str) -> None:
        self.files, self._base = files, base
        root = files.root
        if root.tag != "mujoco":
            files.refuse(root, f"the top element is <{root.tag}>, not <mujoco>", "Pass a model of MuJoCo.")
        for element in root:
            if element.tag not in _SECTIONS and isinstance(element, Element):
                files.refuse(element, f"<{element.tag}> is not covered", did_you_mean(element.tag, _SECTIONS))
        self.settings = self._settings()
        self._defaults = Defaults(files)
        self._disabled = self._flags()
        self.gravity = self._gravity()
        self.links: dict[str, LinkEntry] = {"world": LinkEntry("world", 0.0, np.zeros(3), np.zeros((3, 3)))}
        self.joints: list[JointEntry] = []
        self.places: dict[str, Array] = {"world": np.eye(4)}
        """Of each link in the world, at the initial configuration."""
        self.bodies, self.sites, self.names = {"world": "world"}, dict[str, str](), dict[str, tuple[str, ...]]()
        """Links of bodies and sites, and joints made of each joint of the file, by its name."""
        self.initial: dict[str, float | Array] = {}
        self.shapes: dict[str, list[str]] = {}
        self.notes: list[str] = []
        self.forces = Forces(self._disabled)
        self._positions: list[tuple[str, ...]] = []  # joints in the order of qpos
        self._skipped: list[tuple[int, int]] = []  # in qpos, of no joint here: before which, how many
        self._colliding = False
        self._keyframe = keyframe

    # --- sections -----------------------------------------------------------------------------------------------------

    def _sections(self, tag: str) -> Iterator[Element]:
        for section in self.files.root:
            if section.tag == tag and isinstance(section, Element):
                yield section

    def _elements(self, tag: str) -> Iterator[Part]:
        for section in self._sections(tag):
            for element in section:
                if isinstance(element, Element):
                    yield self._part(element, "", tag)

    def _part(self, element: Element, inherited: str, section: str = "") -> Part:
        defaults = self._defaults.of(self.files, element, inherited, section)
        return Part(self.files, element, self.settings, defaults)

    def _settings(self) -> CompilerSettings:
        given: dict[str, str] = {}
        for section in self._sections("compiler"):
            part = Part(self.files, section, CompilerSettings())
            part.require_known(_OF_COMPILER)
            given.update(section.attrib)
            for child in section:
                if child.tag != "lengthrange" and isinstance(child, Element):
                    self.files.refuse(child, f"<{child.tag}> is not covered")
            for key, harmless in (
                *(("coordinate", ("local",)), ("balanceinertia", ("false",)), ("alignfree", ("false", "auto"))),
                *(("boundmass", ("0",)), ("boundinertia", ("0",)), ("settotalmass", ("-1",))),
            ):
                if section.get(key, harmless[0]).strip() not in harmless:
                    part.refuse(f"the compiler has {key}={shown(section.get(key))}, which is not covered")
        first = next(self._sections("compiler"), self.files.root)
        merged = Part(self.files, first, CompilerSettings(), given)
        sequence = given.get("eulerseq", "xyz")
        if len(sequence) != 3 or not set(sequence.lower()) <= set("xyz"):
            merged.refuse(f"the compiler has eulerseq={shown(sequence)}", "Write three of xyz, or of XYZ.")
        groups = merged.numbers("inertiagrouprange", 2, default="0 5")
        chosen = {
            key: given.get(key, default) for key, default in (("autolimits", "true"), ("inertiafromgeom", "auto"))
        }
        if chosen["autolimits"] not in ("true", "false") or chosen["inertiafromgeom"] not in ("true", "false", "auto"):
            merged.refuse("the compiler has autolimits or inertiafromgeom of another value than true, false, auto")
        return CompilerSettings(
            given.get("angle", "degree") != "radian",
            sequence,
            chosen["autolimits"] == "true",
            chosen["inertiafromgeom"],
            (float(groups[0]), float(groups[1])),
        )

    def _gravity(self) -> Array:
        gravity = np.array([0.0, 0.0, -9.81])
        self._fluid = False
        for section in self._sections("option"):
            part = Part(self.files, section, self.settings)
            if part.has("gravity"):
                gravity = part.numbers("gravity", 3)
            self._fluid |= any(part.number(key, 0.0) != 0.0 for key in ("density", "viscosity"))
        return np.zeros(3) if "gravity" in self._disabled else gravity

    def _flags(self) -> set[str]:
        """Return the flags that are disabled; of several that say one, the last counts."""
        flags: dict[str, Part] = {}
        for section in self._sections("option"):
            for child in section:
                if not isinstance(child, Element):
                    continue
                part = Part(self.files, child, self.settings)
                if part.tag != "flag":
                    part.refuse(f"<{part.tag}> is not covered", did_you_mean(part.tag, ["flag"]))
                for key in child.attrib:
                    if key not in _FLAGS:
                        part.refuse(f"there is no flag {shown(key)}", did_you_mean(key, _FLAGS).strip())
                    part.choice(key, ("enable", "disable"), "enable")
                    flags[key] = part
        disabled = {key for key, part in flags.items() if part.text(key) == "disable"}
        for key in sorted(disabled & {"constraint", "equality"}):
            flags[key].refuse(f"the flag {key}=disable is not covered: loops would be open")
        return disabled

    # --- bodies -------------------------------------------------------------------------------------------------------

    def mechanism(self) -> Mechanism:
        """Return what the file describes."""
        for section in self._sections("worldbody"):
            self._contents(self._part(section, ""), "world", "world", np.eye(4), section.get("childclass", ""))
        if len(self.bodies) == 1:
            self.files.refuse(self.files.root, "the model has no bodies")
        start = self._start()
        closures, couplings = self._equalities()
        actuated = self._actuators()
        for part in self._elements("tendon"):
            self.forces.read_tendon(part)
        if self._fluid:
            self.forces.left_out["fluid"] = ["density or viscosity of the option"]
        self.notes += self.forces.notes(self._colliding)
        return mechanism_of_tree(
            self.files.root.get("model") or self.files.path.stem,
            self.links,
            tuple(self.joints),
            closures,
            actuated,
            self.gravity,
            start,
            armature=self.forces.armature,
            path=str(self.files.path),
            forces=tuple(self.forces.loads),
            notes=tuple(self.notes),
            shapes=drawn(self.shapes),
            couplings=couplings,
        )

    def _contents(self, part: Part, body: str, link: str, frame: Array, inherited: str) -> None:
        """Read the bodies and sites in a body or the world, and in frames there.

        Args:
            part: the element.
            body: name of the body, for messages.
            link: the link that its contents are fixed to.
            frame: (4, 4) of the element in that link.
            inherited: class of defaults around it.
        """
        for child in part.element:
            if not isinstance(child, Element):
                continue
            inner = self._part(child, inherited)
            tag = inner.tag
            if tag == "body":
                self._body(inner, link, frame, inherited)
            elif tag == "site":
                inner.require_known(_OF_SITE)
                self._site(inner, link, frame)
            elif tag == "frame":
                inner.require_known((*POSE, "childclass"))
                within = frame @ inner.placement()
                self._contents(inner, body, link, within, child.get("childclass", inherited))
            elif tag in ("joint", "freejoint", "inertial", "geom"):
                if body == "world" and tag != "geom":
                    inner.refuse(f"the world has a {tag}", "Put it into a body.")
                if tag == "geom":
                    inner.require_known(_OF_GEOM)
                    self._colliding |= inner.text("contype", "1") != "0" or inner.text("conaffinity", "1") != "0"
            elif tag not in ("camera", "light"):
                inner.refuse(f"<{tag}> is not covered")

    def _body(self, part: Part, parent: str, frame: Array, inherited: str) -> None:
        part.require_known(_OF_BODY)
        if part.text("mocap", "false") != "false":
            part.refuse(f"{part} is a mocap body, which is not covered", "Make it a body without joints.")
        if part.number("gravcomp", 0.0) != 0.0:
            self.forces.left_out.setdefault("gravcomp", []).append(part.name or "a body")
        inherited = part.element.get("childclass", inherited)
        name = self._fresh(part.name or f"body_{len(self.bodies)}", part)
        if part.name in self.bodies:
            part.refuse(f"there are two bodies {part.name!r}", "Rename one.")
        place = frame @ part.placement()
        own = list(self._of_body(part, np.eye(4), inherited))
        joints = [(each, within) for each, within in own if each.tag in ("joint", "freejoint")]
        for geom, within in own:
            if geom.tag == "geom" and (shape := shape_of(geom, within)):
                self.shapes.setdefault(name, []).append(shape)
        mass = body_mass(part, name, own)
        self.places[name] = self.places[parent] @ place
        link, rest = parent, place
        welded = self._base == "fixed" and parent == "world" and self._is_floating([joint for joint, _ in joints])
        for number, (joint, within) in enumerate([] if welded else joints):
            link, rest = self._joint(joint, within, link, rest, name, number, len(joints))
        self._link(mass, link, rest, name)
        self.bodies[part.name or name] = name
        self._contents(part, name, name, np.eye(4), inherited)

    def _is_floating(self, joints: list[Part]) -> bool:
        """Whether joints give a body all six freedoms; if so, their place in qpos is noted."""
        kinds = ["free" if part.tag == "freejoint" else part.text("type", "hinge") for part in joints]
        freedoms = {"free": 6, "ball": 3, "hinge": 1, "slide": 1}
        if sum(freedoms.get(kind, 0) for kind in kinds) != 6:
            return False
        self._skipped += [(len(self._positions), {"free": 7, "ball": 4}.get(kind, 1)) for kind in kinds]
        return True

    def _of_body(self, part: Part, frame: Array, inherited: str) -> Iterator[tuple[Part, Array]]:
        """Give the joints, geoms and inertial of a body, with the frame (4, 4) that each is written in."""
        for child in part.element:
            if not isinstance(child, Element):
                continue
            inner = self._part(child, inherited)
            if inner.tag == "frame":
                yield from self._of_body(inner, frame @ inner.placement(), child.get("childclass", inherited))
            elif inner.tag in ("joint", "freejoint", "geom", "inertial"):
                yield inner, frame

    def _fresh(self, name: str, part: Part) -> str:
        """Return a name that no link has: bodies, sites and what is made for closures have one space of names here."""
        if name not in self.links:
            return name
        return next(
            f"{part.tag}:{name}" + "'" * i for i in range(99) if f"{part.tag}:{name}" + "'" * i not in self.links
        )

    def _link(self, mass: LinkEntry, parent: str, placement: Array, name: str) -> None:
        self.links[name] = replace(mass, name=name)
        self.joints.append(JointEntry(f"{name}::fixed", "fixed", parent, name, placement, np.zeros(3), {}))

    def _frame(self, name: str, parent: str, placement: Array) -> None:
        self._link(LinkEntry(name, 0.0, np.zeros(3), np.zeros((3, 3))), parent, placement, name)
        self.places[name] = self.places[parent] @ placement

    def _site(self, part: Part, link: str, frame: Array) -> None:
        name = self._fresh(part.name or f"site_{len(self.sites)}", part)
        if part.name in self.sites:
            part.refuse(f"there are two sites {part.name!r}", "Rename one.")
        self._frame(name, link, frame @ place_of_geom(part))
        self.sites[part.name or name] = name

    # --- joints -------------------------------------------------------------------------------------------------------

    def _joint(
        self, part: Part, within: Array, parent: str, place: Array, body: str, number: int, count: int
    ) -> tuple[str, Array]:
        """Add a joint; return the link behind it, and the placement (4, 4) of the body's frame in that link."""
        kind = "free" if part.tag == "freejoint" else part.choice("type", ("hinge", "slide", "ball", "free"), "hinge")
        part.require_known(("group", "align") if part.tag == "freejoint" else _OF_JOINT)
        name = part.name or (f"{body}_joint" if count == 1 else f"{body}_joint_{number + 1}")
        if name in self.names:
            part.refuse(f"there are two joints {name!r}", "Rename one.")
        self.forces.read(part, name, kind)
        if kind == "free":
            return self._free(part, name, parent, place, count)
        if part.has("armature"):
            rotor = part.number("armature", 0.0)
            if rotor < 0.0:
                part.refuse(f"{part} has armature={rotor:g}")
            self.forces.armature[name] = rotor
        anchor = within @ np.append(part.numbers("pos", 3, default="0 0 0"), 1.0)
        anchored = place @ placed(np.eye(3), anchor[:3])
        back = placed(np.eye(3), -anchor[:3])
        self.names[name] = (name,)
        self._positions.append((name,))
        if kind == "ball":
            if part.limited("limited", "range"):
                self.forces.left_out.setdefault("range", []).append(name)
            self._moving(JointEntry(name, "ball", parent, f"{name}::link", anchored, np.zeros(3), UNLIMITED))
            self.initial[name] = np.array([0.0, 0.0, 0.0, 1.0])
            return f"{name}::link", back
        axis = within[:3, :3] @ part.numbers("axis", 3, default="0 0 1")
        length = float(np.linalg.norm(axis))
        if not length > 1e-12:
            part.refuse(f"{part} has an axis of length zero", "Correct it.")
        axis = axis / length
        turning = kind == "hinge"
        unit = math.pi / 180.0 if turning and self.settings.degrees else 1.0
        ref = unit * part.number("ref", 0.0)
        # at the initial configuration q is ref: the joint is mounted as far back
        mounted = placed(about(axis, -ref), np.zeros(3)) if turning else placed(np.eye(3), -ref * axis)
        limits = dict(UNLIMITED)
        if part.limited("limited", "range"):
            limits["lower"], limits["upper"] = (unit * part.numbers("range", 2)).tolist()
        if part.limited("actuatorfrclimited", "actuatorfrcrange"):
            self.forces.ranges[name] = part.numbers("actuatorfrcrange", 2)
        entry = JointEntry(
            name, "revolute" if turning else "prismatic", parent, f"{name}::link", anchored @ mounted, axis, limits
        )
        self._moving(entry)
        self.initial[name] = ref
        return f"{name}::link", back

    def _moving(self, joint: JointEntry) -> None:
        self.links[joint.child] = LinkEntry(joint.child, 0.0, np.zeros(3), np.zeros((3, 3)))
        self.joints.append(joint)

    def _free(self, part: Part, name: str, parent: str, place: Array, count: int) -> tuple[str, Array]:
        """Add the six freedoms of a free body as three slides and three hinges: independent joints have one each."""
        if parent != "world" or count > 1:
            part.refuse(f"{part} is free, in a body that is inside of another or has other joints")
        if part.number("armature", 0.0):
            part.refuse(f"{part} is free and has an armature, which is not covered")
        made, start = six_joints(name, parent, f"{name}::link", place)
        for joint in made:
            self._moving(joint)
        self.names[name] = tuple(start)
        self._positions.append(tuple(start))
        self.initial.update(start)
        self.notes.append(
            f"The free joint {name!r} is three slides and three hinges (yaw, pitch, roll; singular at a pitch of 90°): "
            f"{', '.join(start)}. Nothing drives it; base=fixed holds it."
        )
        return f"{name}::link", np.eye(4)

    # --- what closes loops, what drives, where it starts --------------------------------------------------------------

    def _equalities(self) -> tuple[tuple[Closure, ...], tuple[Coupling, ...]]:
        closures: list[Closure] = []
        couplings: list[Coupling] = []
        for number, part in enumerate(self._elements("equality")):
            name = part.name or f"{part.tag}_{number + 1}"
            if part.tag not in _EQUALITIES:
                kinds = ", ".join(_EQUALITIES)
                part.refuse(f"{part} is an equality of another kind than {kinds}, which is not covered")
            part.require_known(("active", "solref", "solimp", *_EQUALITIES[part.tag]))
            if part.choice("active", ("true", "false"), "true") == "false":
                self.notes.append(f"The equality {name!r} is not active, and left out.")
                continue
            if len(closures) + len(couplings) == MOST_FREEDOMS:  # each takes a freedom at least
                part.refuse(f"{part} is one more than the {MOST_FREEDOMS} that a model may have")
            if part.tag == "joint":
                couplings.append(self._coupling(part, name))
                continue
            first, second = self._ends(part, name)
            if self._carrier(first) == self._carrier(second):
                part.refuse(f"{part} joins two frames of one rigid body", "Take it out.")
            closures.append(Closure(name, first, second, AXES[:3] if part.tag == "connect" else AXES))
        return tuple(closures), tuple(couplings)

    def _coupling(self, part: Part, name: str) -> Coupling:
        """Return q₁ − r₁ = Σ a_k (q₂ − r₂)^k in powers of q₂; r are positions at the initial configuration."""
        joints = {joint.name for joint in self.joints if joint.kind in ("revolute", "prismatic")}
        ends = []
        for key in ("joint1", "joint2")[: 1 + part.has("joint2")]:
            if (end := part.text(key)) not in joints:
                remedy = did_you_mean(end, joints).strip()
                part.refuse(f"{part} names {key}={shown(end)}, which is no joint of one freedom", remedy)
            ends.append(end)
        given = part.numbers("polycoef", 1, 5, default="0 1 0 0 0")
        offset, *rest = (float(self.initial[end]) for end in ends)
        polynomial = np.polynomial.Polynomial(given if rest else given[:1])
        powers = (polynomial(np.polynomial.Polynomial([-rest[0], 1.0])) if rest else polynomial).coef
        powers[0] += offset
        return Coupling(name, ends[0], ends[1] if rest else "", tuple(np.trim_zeros(powers, "b").tolist() or [0.0]))

    def _ends(self, part: Part, name: str) -> tuple[str, str]:
        """Return the two links that an equality makes coincide."""
        if part.has("site1") or part.has("site2"):
            if any(part.has(key) for key in ("body1", "body2", "anchor", "relpose")):
                part.refuse(f"{part} names sites and bodies", "Name one or the other.")
            return self._named(part, "site1", self.sites), self._named(part, "site2", self.sites)
        first = self._named(part, "body1", self.bodies)
        second = self._named(part, "body2", self.bodies) if part.has("body2") else "world"
        one, two = self.places[first], self.places[second]
        back = np.linalg.inv
        if part.tag == "connect":
            anchor = placed(np.eye(3), part.numbers("anchor", 3))
            on_first, on_second = anchor, back(two) @ one @ anchor
        else:
            on_second = placed(np.eye(3), part.numbers("anchor", 3, default="0 0 0"))
            pose = part.numbers("relpose", 7, default="0 1 0 0 0 0 0")
            if np.linalg.norm(pose[3:]) > 0.0:
                turn = from_quaternion(pose[3:] / np.linalg.norm(pose[3:]))
                on_first = placed(turn, pose[:3])
            else:
                on_first = back(one) @ two @ on_second
        ends = self._fresh(f"{name}:1", part), self._fresh(f"{name}:2", part)
        self._frame(ends[0], first, on_first)
        self._frame(ends[1], second, on_second)
        return ends

    def _named(self, part: Part, key: str, known: Mapping[str, str]) -> str:
        name = part.text(key)
        if name not in known:
            part.refuse(f"{part} names {key}={shown(name)}, which is not there", did_you_mean(name, known).strip())
        return known[name]

    def _carrier(self, link: str) -> str:
        """Return the moving joint that carries a link; empty for the world's."""
        above = {joint.child: joint for joint in self.joints}
        while link in above and above[link].kind == "fixed":
            link = above[link].parent
        return above[link].name if link in above else ""

    def _actuators(self) -> tuple[str, ...]:
        efforts: dict[str, Array] = {}
        kinds = {joint.name: joint.kind for joint in self.joints}
        feedback = []
        for part in self._elements("actuator"):
            if part.tag not in ("motor", "position", "velocity", "intvelocity", "general"):
                part.refuse(f"<{part.tag}> is not covered", "Use motor, position, velocity or general on a joint.")
            part.require_known(_OF_ACTUATOR, _NO_TRANSMISSION)
            key = "joint" if part.has("joint") else "jointinparent"
            name = part.text(key)
            made = self.names.get(name)
            if made is None:
                part.refuse(f"{part} drives {shown(name)}, which is no joint", did_you_mean(name, self.names).strip())
            if len(made) != 1 or kinds.get(name) == "ball":
                part.refuse(f"{part} drives {name!r}, a joint of several freedoms", _NO_JOINT)
            effort, servo = forces_of(part)
            efforts[name] = efforts.get(name, np.zeros(2)) + effort
            if servo:
                feedback.append(name)
        bounds = {**self.forces.ranges, **efforts}
        for name in self.forces.ranges.keys() & efforts.keys():
            bounds[name] = efforts[name].clip(*self.forces.ranges[name])
        for number, joint in enumerate(self.joints):
            if joint.name in bounds:
                least, most = bounds[joint.name].tolist()
                limits = {**joint.limits, "effort": most, "effort_lower": least}
                self.joints[number] = replace(joint, limits=limits)
                if least != -most:
                    self.notes.append(f"Efforts of {joint.name} are from {least:g} to {most:g}: robot.effort_limits.")
        if feedback:
            self.notes.append(f"Servos count as motors, their control law is left out: {', '.join(feedback)}.")
        return tuple(efforts)

    def _start(self) -> dict[str, float | Array]:
        keys = [part for part in self._elements("keyframe") if part.tag == "key"]
        if not self._keyframe:
            return self.initial
        chosen = next((part for part in keys if part.name == self._keyframe), None)
        if chosen is None:
            names = ", ".join(part.name for part in keys if part.name) or "none"
            root = self.files.root
            self.files.refuse(root, f"there is no keyframe {self._keyframe!r}", f"Its keyframes: {names}.")
        if not chosen.has("qpos"):
            return self.initial
        sizes = [self._size(made) for made in self._positions]
        skipped = sum(size for _, size in self._skipped)
        values, start = list(chosen.numbers("qpos", sum(sizes) + skipped)), dict(self.initial)
        for number, (made, size) in enumerate(zip(self._positions, sizes, strict=True)):
            del values[: sum(each for before, each in self._skipped if before == number)]
            part, values = np.array(values[:size]), values[size:]
            if size == 1:
                start[made[0]] = float(part[0])
            elif size == 4:
                start[made[0]] = np.roll(_unit(part), -1)
            else:
                yaw, pitch, roll = angles(from_quaternion(_unit(part[3:])))
                start.update(zip(made, (*part[:3].tolist(), roll, pitch, yaw), strict=True))
        return start

    def _size(self, made: tuple[str, ...]) -> int:
        """Return how many numbers of qpos a joint has, made of one joint here, or of six."""
        return 7 if len(made) > 1 else 4 if isinstance(self.initial[made[0]], np.ndarray) else 1


def _unit(wxyz: Array) -> Array:
    """Return a quaternion (4,) of length one; as MuJoCo does, that of no turn where all its numbers are zero."""
    length = float(np.linalg.norm(wxyz))
    return np.array([1.0, 0.0, 0.0, 0.0]) if length < _SMALLEST else wxyz / length
