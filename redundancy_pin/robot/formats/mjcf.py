"""Read MJCF, the models of MuJoCo: bodies, joints and sites, the equalities that close loops, what drives the joints.

MuJoCo's own compiler reads the file (extra ``mjcf``): defaults, composites, masses of meshes and the rest are as it has
them. Elements that no rigid mechanism has are refused by name; ignored elements are named in the notes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.errors import ModelFileError, did_you_mean, optional
from redundancy_pin.robot.formats.mechanism import (
    MOST_FREEDOMS,
    MOST_LINKS,
    NOT_IN_FORCE,
    SIX,
    Mechanism,
    drawn,
    in_a_row,
    six_positions,
)
from redundancy_pin.robot.formats.mjcf_compiled import MUJOCO, Compiled, compile_mjcf, rotation_of, word
from redundancy_pin.robot.loads import JointForces
from redundancy_pin.robot.lookup import find_joint, find_joint_index, has_joint, has_link
from redundancy_pin.robot.loop_joints import LoopJoint
from redundancy_pin.robot.rebuild import axis_of, joint_along, span
from redundancy_pin.robot.types import Coupling, slides

_NO_ENDS = np.array([-np.inf, np.inf])

_UNNAMED = "MuJoCo Model"
"""What MuJoCo calls a model without a name."""

_RIGID_TIME, _RIGID_IMPEDANCE = 0.02, 0.9
"""Time constant (s) times damping ratio, and impedance (0 to 1), of equalities by MuJoCo's defaults solref, solimp."""

_NO_JOINT = "Drive a joint or a fixed tendon."
_LAWS = {
    "dyn": ("none", "integrator", "filter", "filterexact", "pid"),
    "gain": ("fixed", "affine", "pid"),
    "bias": ("none", "affine"),
}
"""What the force of an actuator may follow from; muscles and motors with circuits of their own are others."""

_FORCES = {
    "damping": ("damper", "damping"),
    "frictionloss": ("frictionloss", "friction"),
    "stiffness": ("spring", "stiffness"),
}
"""Forces of joints, the flags that disable them, and what ``JointForces`` calls them."""


def read_mjcf(
    path: Path, *, keyframe: str = "", base: str = "free", trust: bool = False, untrusted: bool = False
) -> Mechanism:
    """Read a model of MuJoCo.

    Args:
        path: the file.
        keyframe: name of the keyframe that the mechanism starts from; the initial configuration when empty.
        base: "free", or "fixed" to hold bodies with free joints where they start.
        trust: let it name files outside its folder.
        untrusted: compile it in a child process with limits of time and memory.

    Raises:
        ModelFileError: naming the file: what MuJoCo refuses, or a rigid mechanism cannot mean.
        RedundancyPinError: MuJoCo is not installed.
    """
    return _Reader(path, compile_mjcf(path, trust=trust, untrusted=untrusted), keyframe, base).mechanism()


class _Reader:
    """What is gathered on the way from MuJoCo's model to Pinocchio's."""

    def __init__(self, path: Path, compiled: Compiled, keyframe: str, base: str) -> None:
        self.path, self.compiled, self.m, self.base = path, compiled, compiled.model, base
        self.left_out: dict[str, list[str]] = {}
        self._require_rigid()
        self.model = pin.Model()
        name = self.m.names.partition(b"\0")[0].decode()
        self.model.name = name if name != _UNNAMED else path.stem
        self.disabled = {flag for flag, _ in _FORCES.values() if self._is_disabled(flag)}
        self.qpos: Array = self._start(keyframe)
        self.links: list[str] = []
        self.sites: list[str] = []
        self.joints: list[tuple[str, ...]] = [() for _ in range(self.m.njnt)]
        """By joint of the file, what it is made of here; nothing where it is held."""
        self.places: list[tuple[int, pin.SE3]] = [(0, pin.SE3.Identity())]
        """By body, the joint that carries it and its placement there."""
        self.start: dict[str, Any] = {}
        self.armature: dict[str, Array] = {}
        self.efforts: dict[str, Array] = {}
        """By joint of one degree of freedom, its least and largest effort (2,)."""
        self.loads: dict[str, dict[str, float]] = {}
        self.tendons: dict[int, str] = {}
        """By fixed tendon, the joint that has its length as position."""
        self.couplings: list[Coupling] = []
        self.notes: list[str] = []

    def mechanism(self) -> Mechanism:
        """Return what the file describes."""
        self._bodies()
        self._add_sites()
        for tendon in range(self.m.ntendon):
            if any(self._has(f"tendon_{what}", tendon) for what in _OF_TENDONS):
                self._joint_of_tendon(tendon)
        loop_joints = tuple(self._equalities())
        actuated = self._actuators()
        for tendon, is_limited in enumerate(self.m.tendon_limited):
            if is_limited and tendon not in self.tendons:
                self._leave_out("range", self._label(tendon))
        model = self.model
        model.gravity.linear = np.zeros(3) if self._is_disabled("gravity") else self.m.opt.gravity
        armature, least, most = np.zeros(model.nv), np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
        for name, inertia in self.armature.items():
            armature[span(model, find_joint_index(model, name), "v")] = inertia
        for name, ends in self.efforts.items():
            least[find_joint(model, name).idx_v], most[find_joint(model, name).idx_v] = ends
        model.armature, model.lowerEffortLimit, model.upperEffortLimit = armature, least, most
        q: Array = pin.neutral(model)
        for name, value in self.start.items():
            q[span(model, find_joint_index(model, name), "q")] = value
        forces = tuple(JointForces(name, **load) for name, load in self.loads.items() if any(load.values()))
        shapes: dict[str, list[str]] = {}
        for body, shape in self.compiled.shapes:
            shapes.setdefault(self.links[body], []).append(shape)
        return Mechanism(
            str(model.name),
            model,
            q,
            loop_joints,
            tuple(self.couplings),
            actuated,
            forces=forces,
            notes=self._all_notes(forces),
            shapes=drawn(shapes),
        )

    # --- what is refused, and what is noted ---------------------------------------------------------------------------

    def _refuse(self, what: str, remedy: str) -> NoReturn:
        raise ModelFileError(f"{self.path}: {what}.", remedy=remedy, path=str(self.path))

    def _is_disabled(self, flag: str) -> bool:
        return bool(self.m.opt.disableflags & getattr(optional(*MUJOCO).mjtDisableBit, f"mjDSBL_{flag.upper()}"))

    def _has(self, name: str, index: int) -> bool:
        """Return whether an entry is not zero, of an array that releases of MuJoCo from 3.6 on may lack."""
        return hasattr(self.m, name) and bool(np.any(getattr(self.m, name)[index]))

    def _require_rigid(self) -> None:
        """Refuse what a rigid mechanism cannot mean, and more of it than a model may have."""
        m = self.m
        for count, most, what in (
            (m.nv, MOST_FREEDOMS, "degrees of freedom"),
            (m.nbody, MOST_LINKS, "bodies"),
            (m.neq, MOST_FREEDOMS, "equalities"),
        ):
            if count > most:
                self._refuse(
                    f"the model has {count} {what}, more than the {most} that one may have",
                    "Take out what is no part of the mechanism.",
                )
        if m.nbody == 1:
            self._refuse("the model has no bodies", "Give it some.")
        bodies = [m.body(number).name or f"body {number}" for number in range(m.nbody)]
        joints = [m.joint(number).name for number in range(m.njnt)]
        for found, what in (
            (m.nflex, "soft bodies (flex)"),
            (max(m.opt.density, m.opt.viscosity) > 0.0, "a fluid (density or viscosity of the option)"),
            *((self._has("body_gravcomp", body), f"gravcomp of {name}") for body, name in enumerate(bodies)),
            *((m.body_plugin[body] >= 0, f"a plugin of {name}") for body, name in enumerate(bodies)),
            *(
                (self._has("jnt_springyield", joint), f"a yielding spring of {name}")
                for joint, name in enumerate(joints)
            ),
            *(
                (np.any(m.eq_active0) and self._is_disabled(flag), f"equalities that the flag {flag}=disable opens")
                for flag in ("equality", "constraint")
            ),
        ):
            if found:
                self._refuse(f"it has {what}, which is not covered", "Take it out.")

    def _all_notes(self, forces: Sequence[JointForces]) -> tuple[str, ...]:
        notes = [*self.notes, *(f"MuJoCo warns: {each}." for each in self.compiled.warnings)]
        if listed := "; ".join(f"{what} of {', '.join(names)}" for what, names in self.left_out.items()):
            notes.append(f"{NOT_IN_FORCE} {listed}.")
        collides = self.m.npair or np.any(self.m.geom_contype | self.m.geom_conaffinity)
        if collides and not self._is_disabled("contact"):
            notes.append("Contacts between geoms are not modelled.")
        if self.disabled:
            notes.append(f"Disabled by flags of the model: {', '.join(sorted(self.disabled))}.")
        if forces:
            notes.append(f"In force: damping, friction and springs of {', '.join(load.joint for load in forces)}.")
        if turning := [name for name, inertia in self.armature.items() if np.any(inertia)]:
            notes.append(f"In force: armature of {', '.join(turning)}.")
        if mocap := [link for link, number in zip(self.links, self.m.body_mocapid, strict=True) if number >= 0]:
            notes.append(f"Mocap bodies stay where they are: {', '.join(mocap)}.")
        return tuple(notes)

    # --- bodies and joints --------------------------------------------------------------------------------------------

    def _start(self, keyframe: str) -> Array:
        """Return qpos of a keyframe, or the initial one."""
        if not keyframe:
            return np.array(self.m.qpos0)
        names = [self.m.key(number).name for number in range(self.m.nkey)]
        if keyframe not in names:
            listed = ", ".join(filter(None, names)) or "none"
            self._refuse(
                f"there is no keyframe {keyframe!r}", f"{did_you_mean(keyframe, names)}Its keyframes: {listed}."
            )
        return np.array(self.m.key_qpos[names.index(keyframe)])

    def _bodies(self) -> None:
        m = self.m
        self.links.append(self._link("world", "body", 0, pin.SE3.Identity()))
        for body in range(1, m.nbody):
            carrier, place = self.places[m.body_parentid[body]]
            place = place * pin.SE3(rotation_of(m.body_quat[body]), m.body_pos[body])
            name = m.body(body).name or f"body_{body}"
            joints = range(m.body_jntadr[body], m.body_jntadr[body] + m.body_jntnum[body])
            freedoms = {"free": 6, "ball": 3}
            is_floating = sum(freedoms.get(word("Joint", m.jnt_type[joint]), 1) for joint in joints) == 6
            is_held = self.base == "fixed" and m.body_parentid[body] == 0 and is_floating
            place = self._placed(body) if is_held else place
            for number, joint in enumerate(() if is_held else joints):
                single = "" if len(joints) == 1 else f"_{number + 1}"
                own = m.joint(joint).name or f"{name}_joint{single}"
                carrier, place = self._joint(joint, own, carrier, place)
            turn = rotation_of(m.body_iquat[body])
            inertia = turn @ np.diag(m.body_inertia[body]) @ turn.T
            if m.body_mass[body] or inertia.any():
                of_body = pin.Inertia(float(m.body_mass[body]), np.array(m.body_ipos[body]), inertia)
                self.model.appendBodyToJoint(carrier, of_body, place)
            self.places.append((carrier, place))
            self.links.append(self._link(name, "body", carrier, place))

    def _link(self, name: str, kind: str, carrier: int, place: pin.SE3) -> str:
        """Add a frame for a body or site, which have one space of names here; return its name."""
        if has_link(self.model, name):
            name = f"{kind}:{name}"
        while has_link(self.model, name):
            name += "'"
        self.model.addBodyFrame(name, carrier, place, 0)
        return name

    def _add_sites(self) -> None:
        m = self.m
        for site, body in enumerate(m.site_bodyid):
            carrier, place = self.places[body]
            place = place * pin.SE3(rotation_of(m.site_quat[site]), m.site_pos[site])
            self.sites.append(self._link(m.site(site).name or f"site_{site}", "site", carrier, place))

    def _placed(self, body: int) -> pin.SE3:
        """Return where MuJoCo has a body at the start."""
        mujoco = optional(*MUJOCO)
        data = mujoco.MjData(self.m)
        data.qpos[:] = self.qpos
        mujoco.mj_kinematics(self.m, data)
        return pin.SE3(rotation_of(data.xquat[body]), data.xpos[body])

    def _joint(self, joint: int, name: str, carrier: int, place: pin.SE3) -> tuple[int, pin.SE3]:
        """Add a joint to a body at a placement; return the joint that carries the body, and the placement there."""
        m, kind = self.m, word("Joint", self.m.jnt_type[joint])
        at, dof = m.jnt_qposadr[joint], m.jnt_dofadr[joint]
        single, rest = kind in ("hinge", "slide"), m.qpos_spring[at]
        curved = self._has("dof_dampingpoly", dof), self._has("jnt_stiffnesspoly", joint)
        self._take(name, "damping", m.dof_damping[dof], curved=curved[0], covered=kind != "free")
        self._take(name, "frictionloss", m.dof_frictionloss[dof], curved=False, covered=single)
        self._take(name, "stiffness", m.jnt_stiffness[joint], curved=curved[1], covered=single, rest=rest)
        if kind == "free":
            if np.any(m.dof_armature[dof : dof + 6]):
                self._refuse(f"the joint {name!r} is free and has an armature, which is not covered", "Take it out.")
            row = in_a_row(name, SIX)
            for own, model in row:
                carrier = self.model.addJoint(carrier, model, pin.SE3.Identity(), own)
            self.joints[joint] = tuple(own for own, _ in row)
            self.start.update(zip(self.joints[joint], six_positions(self._placed(m.jnt_bodyid[joint])), strict=True))
            self.notes.append(
                f"The free joint {name!r} is three slides and three hinges (yaw, pitch, roll; singular at a pitch of "
                f"90°): {', '.join(self.joints[joint])}. Nothing drives it; base=fixed holds it."
            )
            return carrier, pin.SE3.Identity()
        self.joints[joint] = (name,)
        self.armature[name] = m.dof_armature[dof]
        anchor = pin.SE3(np.eye(3), np.array(m.jnt_pos[joint]))
        limited = bool(m.jnt_limited[joint])
        if kind == "ball":
            if limited:
                self._leave_out("range", name)
            self.start[name] = pin.Quaternion(rotation_of(self.qpos[at : at + 4])).coeffs()
            return self.model.addJoint(carrier, pin.JointModelSpherical(), place * anchor, name), anchor.inverse()
        axis, ref = np.array(m.jnt_axis[joint]), float(m.qpos0[at])
        # at the initial configuration q is ref: the joint is mounted as far back
        back = pin.SE3(pin.exp3(-ref * axis), np.zeros(3)) if kind == "hinge" else pin.SE3(np.eye(3), -ref * axis)
        self.start[name] = float(self.qpos[at])
        ends = m.jnt_range[joint] if limited else _NO_ENDS
        bounds = m.jnt_actfrcrange[joint] if m.jnt_actfrclimited[joint] else _NO_ENDS
        turns = "revolute" if kind == "hinge" else "prismatic"
        return self._single(name, turns, axis, carrier, place * anchor * back, ends, bounds), anchor.inverse()

    def _single(
        self, name: str, kind: str, axis: Array, carrier: int, place: pin.SE3, ends: Array, efforts: Array
    ) -> int:
        """Add a joint of one degree of freedom between ends (2,), with bounds of its effort (2,); return its index."""
        none, lower, upper = np.array([np.inf]), ends[:1], ends[1:]
        self.efforts[name] = efforts
        return int(self.model.addJoint(carrier, joint_along(kind, axis), place, name, none, none, lower, upper))

    def _leave_out(self, what: str, name: str) -> None:
        names = self.left_out.setdefault(what, [])
        if name not in names:
            names.append(name)

    def _take(
        self, name: str, what: str, value: float, *, curved: bool, covered: bool = True, rest: float = 0.0
    ) -> None:
        """Activate a force of a joint if it is covered and linear, unless a flag of the model disables it."""
        flag, key = _FORCES[what]
        if flag in self.disabled or not (value or curved):
            return
        if curved or not covered:
            self._leave_out(what, name)
            return
        load = self.loads.setdefault(name, {})
        load[key] = load.get(key, 0.0) + float(value)
        if what == "stiffness":
            load["rest"] = float(rest)

    # --- tendons ------------------------------------------------------------------------------------------------------

    def _label(self, tendon: int) -> str:
        return str(self.m.tendon(tendon).name or f"tendon_{tendon + 1}")

    def _wraps(self, tendon: int) -> range:
        return range(self.m.tendon_adr[tendon], self.m.tendon_adr[tendon] + self.m.tendon_num[tendon])

    def _terms(self, tendon: int) -> list[tuple[str, float]]:
        """Return the joints of a fixed tendon and their factors: its length is the sum of factor · position."""
        m, label = self.m, self._label(tendon)
        if any(word("Wrap", m.wrap_type[wrap]) != "joint" for wrap in self._wraps(tendon)):
            remedy = "Use a fixed tendon, or an equality that holds the distance of two sites."
            self._refuse(f"the tendon {label!r} goes through sites and pulls, which is not covered", remedy)
        return [
            (self._one(int(m.wrap_objid[wrap]), f"the tendon {label!r}"), float(m.wrap_prm[wrap]))
            for wrap in self._wraps(tendon)
        ]

    def _joint_of_tendon(self, tendon: int) -> str:
        """Return the joint without mass whose position is the length of a fixed tendon, to which it is coupled."""
        if tendon in self.tendons:
            return self.tendons[tendon]
        m, label, terms = self.m, self._label(tendon), self._terms(tendon)
        name = label
        while has_joint(self.model, name):
            name += "'"
        data = self.model.createData()
        pin.forwardKinematics(self.model, data, pin.neutral(self.model))
        index = find_joint_index(self.model, terms[0][0])
        kind = "prismatic" if slides(self.model.joints[index]) else "revolute"
        ends = m.tendon_range[tendon] if m.tendon_limited[tendon] else _NO_ENDS
        bounds = m.tendon_actfrcrange[tendon] if self._has("tendon_actfrclimited", tendon) else _NO_ENDS
        self._single(name, kind, axis_of(self.model, index), 0, data.oMi[index], ends, bounds)
        self.start[name] = sum(factor * float(self.start[joint]) for joint, factor in terms)
        self.tendons[tendon] = name
        (of, factor), *more = terms
        self.couplings.append(Coupling(f"length of {name}", name, of, (0.0, factor), tuple(more)))
        if self._has("tendon_armature", tendon):
            self.armature[name] = m.tendon_armature[tendon]
        low, high = (float(end) for end in m.tendon_lengthspring[tendon])
        if m.tendon_stiffness[tendon] and (low != high or self._has("tendon_springyield", tendon)):
            self._refuse(f"the tendon {label!r} has a spring with slack, which is not covered", "Give it one length.")
        self._take(name, "damping", m.tendon_damping[tendon], curved=self._has("tendon_dampingpoly", tendon))
        self._take(name, "frictionloss", m.tendon_frictionloss[tendon], curved=False)
        bent = self._has("tendon_stiffnesspoly", tendon)
        self._take(name, "stiffness", m.tendon_stiffness[tendon], curved=bent, rest=low)
        return name

    def _one(self, joint: int, what: str) -> str:
        """Return the name of a joint of one degree of freedom that moves."""
        if word("Joint", self.m.jnt_type[joint]) not in ("hinge", "slide") or not self.joints[joint]:
            name = self.m.joint(joint).name or f"joint {joint + 1}"
            self._refuse(f"{what} acts on {name!r}, a joint that is held or of several degrees of freedom", _NO_JOINT)
        return self.joints[joint][0]

    # --- equalities ---------------------------------------------------------------------------------------------------

    def _equalities(self) -> Iterator[LoopJoint]:
        m = self.m
        for number in range(m.neq):
            kind = word("Eq", m.eq_type[number])
            name = m.equality(number).name or f"{kind}_{number + 1}"
            if m.eq_active0[number] and self._is_soft(number):
                self._leave_out("softness (solref, solimp)", name)
            one, other, data = int(m.eq_obj1id[number]), int(m.eq_obj2id[number]), m.eq_data[number]
            if not m.eq_active0[number]:
                self.notes.append(f"The equality {name!r} is not active, and left out.")
            elif kind in ("connect", "weld"):
                yield self._loop_joint(number, name, one, other, data)
            elif kind == "joint":
                ends = [self._one(each, f"the equality {name!r}") for each in (one, other) if each >= 0]
                lengths = [float(m.qpos0[m.jnt_qposadr[each]]) for each in (one, other) if each >= 0]
                self._couple(name, ends, lengths, data[:5])
            elif kind == "tendon":
                if rod := self._rod(name, one, other, data):
                    yield rod
                else:
                    self._couple_tendons(name, one, other, data)
            else:
                self._refuse(f"the equality {name!r} is of the kind {kind}, which is not covered", "Take it out.")

    def _is_soft(self, number: int) -> bool:
        """Return whether an equality is softer than by MuJoCo's defaults, so that it may stand for a spring."""
        time, damping = self.m.eq_solref[number]
        # a negative solref is stiffness and damping, in 1/s² and 1/s
        is_slow = time * damping > _RIGID_TIME if time > 0.0 else -time < _RIGID_TIME**-2
        return bool(is_slow or min(self.m.eq_solimp[number][:2]) < _RIGID_IMPEDANCE)

    def _couple(self, name: str, ends: list[str], initial: list[float], polycoef: Array) -> None:
        """Add q₁ − r₁ = Σ a_k (q₂ − r₂)^k in powers of q₂; r are positions at the initial configuration."""
        given = np.polynomial.Polynomial(polycoef[:5] if len(ends) == 2 else polycoef[:1])
        powers = (given(np.polynomial.Polynomial([-initial[1], 1.0])) if len(ends) == 2 else given).coef
        powers[0] += initial[0]
        polynomial = tuple(np.trim_zeros(powers, "b").tolist() or [0.0])
        self.couplings.append(Coupling(name, ends[0], ends[1] if len(ends) == 2 else "", polynomial))

    def _couple_tendons(self, name: str, one: int, other: int, data: Array) -> None:
        """Add the coupling of an equality of one or two tendons: between their joints if it is linear, as most are."""
        tendons = [each for each in (one, other) if each >= 0]
        initial = [float(self.m.tendon_length0[each]) for each in tendons]
        if len(tendons) == 2 and np.any(data[2:5]):
            self._couple(name, [self._joint_of_tendon(each) for each in tendons], initial, data)
            return
        slope = float(data[1]) if len(tendons) == 2 else 0.0
        factors: dict[str, float] = {}  # of Σ factor · position = constant
        for joint, factor in self._terms(one):
            factors[joint] = factors.get(joint, 0.0) + factor
        for joint, factor in self._terms(other) if slope else ():
            factors[joint] = factors.get(joint, 0.0) - slope * factor
        (joint, first), *rest = [(joint, factor) for joint, factor in factors.items() if factor]
        constant = (initial[0] + float(data[0]) - slope * initial[-1]) / first
        (of, slope), *also = [(each, -factor / first) for each, factor in rest] or [("", 0.0)]
        polynomial = (constant, slope) if of else (constant,)
        self.couplings.append(Coupling(name, joint, of, polynomial, tuple(also)))

    def _rod(self, name: str, tendon: int, other: int, data: Array) -> LoopJoint | None:
        """Return the rod that a tendon between two sites is whose length an equality holds; None for other tendons."""
        m, wraps = self.m, self._wraps(tendon)
        if other >= 0 or len(wraps) != 2 or any(word("Wrap", m.wrap_type[wrap]) != "site" for wrap in wraps):
            return None
        first, second = (self.sites[int(m.wrap_objid[wrap])] for wrap in wraps)
        length = float(m.tendon_length0[tendon] + data[0])
        if not length > 0.0:
            self._refuse(f"the equality {name!r} holds two sites at the distance {length:g}", "Use a connect.")
        return LoopJoint(name, "rod", (first, second), length=length)

    def _loop_joint(self, number: int, name: str, one: int, other: int, data: Array) -> LoopJoint:
        is_weld = word("Eq", self.m.eq_type[number]) == "weld"
        kind = "weld" if is_weld and data[10] else "ball"  # data[10] scales the rows of a weld's rotation
        if word("Obj", self.m.eq_objtype[number]) == "site":
            return LoopJoint(name, kind, (self.sites[one], self.sites[other]))
        places = np.eye(4), np.eye(4)
        # MuJoCo keeps a connect's points in the order of its bodies, a weld's the other way round
        for place, point in zip(places, (data[3:6], data[:3]) if is_weld else (data[:3], data[3:6]), strict=True):
            place[:3, 3] = point
        if is_weld:
            places[0][:3, :3] = rotation_of(data[6:10])
        return LoopJoint(name, kind, (self.links[one], self.links[other]), places)

    # --- actuators ----------------------------------------------------------------------------------------------------

    def _actuators(self) -> tuple[str, ...]:
        m = self.m
        efforts: dict[str, Array] = {}
        servos: list[str] = []
        for number in range(m.nu):
            way = word("Trn", m.actuator_trntype[number])
            label, target = m.actuator(number).name or f"actuator {number + 1}", int(m.actuator_trnid[number][0])
            if way in ("joint", "jointinparent"):
                name = self._one(target, f"the actuator {label!r}")
            elif way == "tendon":
                name = self._joint_of_tendon(target)
            else:
                self._refuse(f"the actuator {label!r} acts by a {way}, which is not covered", _NO_JOINT)
            gear = float(m.actuator_gear[number][0])
            if not gear:
                self._refuse(f"the actuator {label!r} has a gear of zero", "Give it another.")
            ends, is_servo = self._force(number, label)
            efforts[name] = efforts.get(name, np.zeros(2)) + np.sort(gear * ends)
            if is_servo and name not in servos:
                servos.append(name)
            if self._has("actuator_armature", number):
                self.armature[name] = self.armature.get(name, 0.0) + gear**2 * m.actuator_armature[number]
            if self._has("actuator_damping", number) or self._has("actuator_dampingpoly", number):
                damping = gear**2 * m.actuator_damping[number]
                self._take(name, "damping", damping, curved=self._has("actuator_dampingpoly", number))
        for name, ends in efforts.items():
            self.efforts[name] = ends.clip(*self.efforts[name])
            least, most = self.efforts[name]
            if least != -most:
                self.notes.append(f"Efforts of {name} are from {least:g} to {most:g}: robot.effort_limits.")
        if servos:
            self.notes.append(f"Servos count as motors, their control law is left out: {', '.join(servos)}.")
        return tuple(efforts)

    def _force(self, number: int, label: str) -> tuple[Array, bool]:
        """Return the least and largest force (2,) of an actuator, N or N·m before its gear; and whether it is a servo.

        The force is infinite if not bounded. Servos have a law of position or speed, which leaves their controls
        without units of force. Other forces are gain · input + bias; the input is the control, or an activation that
        follows it: of a filter within its range too, of an integrator anywhere, except where the activation itself has
        a range.
        """
        m, laws = self.m, {}
        for what, allowed in _LAWS.items():
            laws[what] = law = word(what.capitalize(), getattr(m, f"actuator_{what}type")[number])
            if law not in allowed or m.actuator_plugin[number] >= 0:
                remedy = "Make it a motor, position or velocity."
                self._refuse(f"the actuator {label!r} has {what}type={law}, which is not covered", remedy)
        gains = m.actuator_gainprm[number][: 1 if laws["gain"] == "fixed" else 3]
        terms = m.actuator_biasprm[number][: 0 if laws["bias"] == "none" else 3]
        is_servo = bool(np.any(gains[1:]) or np.any(terms[1:])) or "pid" in laws.values()
        ends = _NO_ENDS
        if not is_servo:
            dynamics, gain, bias = laws["dyn"], float(gains[0]), float(np.sum(terms[:1]))
            if dynamics != "integrator" and m.actuator_ctrllimited[number]:
                ends = np.array(m.actuator_ctrlrange[number])
            if dynamics != "none" and m.actuator_actlimited[number]:
                ends = ends.clip(*m.actuator_actrange[number])
            ends = (gain * ends if gain else np.zeros(2)) + bias
        if m.actuator_forcelimited[number]:
            ends = np.sort(ends).clip(*m.actuator_forcerange[number])
        return np.sort(ends), is_servo


_OF_TENDONS = ("stiffness", "stiffnesspoly", "damping", "dampingpoly", "frictionloss", "armature")
"""What makes a tendon part of the mechanics, where nothing drives it."""
