"""Loops and motors that a model file leaves open: certain ones, and questions on the others.

Loops and motors that a file states are taken. If it states none, names and places are evidence:

| evidence | taken as certain |
|---|---|
| ends ``closing_NAME_1`` and ``closing_NAME_2`` | always |
| ends such as ``rod_loop`` and ``rocker_loop`` | nearly at one point when all joints are at zero |
| marks at one point when all joints are at zero | two named alike or as ends; every other mark is paired, or a frame |
| other marks, such as the only two | never: a gripper has two tips, an arm a base and a tool. They are frames where |
| | every joint is driven, or where neither names nor places suggest a pair |
| motors by name: ``motor1``, on the ground or a slide | independent, and as many as the degrees of freedom |
| motors by name: all joints but ``passive1`` | likewise |
| motors by place: joints on the ground, slides | never |

A mark is a link that is fixed to another one and carries none that moves; it weighs nothing, meets another one when all
joints are at zero, or is named as an end. Loops of marks that meet are not certain where they leave fewer degrees of
freedom than there are motors: arms have marks to park at. What is not certain is a question, with the flag of
``redundancy-pin new`` that answers it.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations, islice, product
from typing import Any

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError, shown
from redundancy_pin.robot.build import characteristic_length
from redundancy_pin.robot.formats.mechanism import Mechanism
from redundancy_pin.robot.inertia import NO_MASS
from redundancy_pin.robot.lookup import (
    find_joint,
    find_joint_index,
    find_link,
    find_link_index,
    joint_names,
    link_names,
)
from redundancy_pin.robot.loop_joints import LoopJoint, joint_between
from redundancy_pin.robot.types import Robot, slides

_COINCIDE = 1e-4
"""Distance of two marks, in characteristic lengths, up to which they are one point: files are rounded."""

_NEARLY = 1e-2
"""The same of marks that are named as ends, or as others that meet: CAD closes some loops by a millimetre."""

_CUTS = frozenset(("closing", "closure", "close", "closed", "loop", "cut"))
"""Words in names of marks that are ends of loops."""

_ENDS = frozenset(("end", "tip", "pin", "mark"))
"""Words in names of marks that may be ends of loops, whatever they weigh."""

_FRAMES = frozenset(
    (
        *("base", "world", "tool", "tcp", "ee", "eef", "effector", "flange", "imu", "camera", "optical", "laser"),
        *("lidar", "sensor", "com", "finger", "fingers", "fingertip", "gripper", "jaw", "hand", "palm", "pad", "foot"),
        *("toe", "heel", "sole", "contact", "dock", "nest", "goal", "target"),
    )
)
"""Words in names of marks that have another use, even where two of them meet, as fingers do."""

_MOTORS = frozenset(("motor", "actuator", "actuated", "servo", "drive", "active"))
"""Words in names of joints that are driven. The driven link of a four-bar is the one that follows."""

_SIDES = frozenset(
    ("joint", "left", "right", "front", "rear", "back", "upper", "lower", "top", "bottom", "inner", "outer")
)
"""Words that may follow those, as numbers and letters may: ``motor_side_elbow`` is an elbow."""

_PASSIVE = frozenset(("passive", "unactuated", "free", "idle"))
"""Words in names of joints that nothing drives."""

KINDS = ("ball", "hinge", "cylinder", "slider", "planar", "weld")
"""Kinds of joints that the frames of two links determine."""

_MOST_SUGGESTIONS = 100
"""Number of pairs named alike that a question suggests: of 1,900 marks there are more than a million."""

_FEWEST_ROWS = 2
"""Rows of a joint that closes a loop: a pin in a plane has two. Fingers on slides that touch have one."""

BY_NAME = "by their names"
BY_FLAG = "by --close"
_MEETING_ENDS = "named as ends that meet when all joints are at zero"
_MEETING = "at one point when all joints are at zero"


@dataclass(frozen=True, eq=False)
class Proposal:
    """The certain facts of a mechanism, and questions on the others.

    Attributes:
        mechanism: with the loops and the motors that are certain; where motors are not, with all joints that could be.
        found: by name of the loop joints that the file does not state, how their ends were found.
        motors: how the motors were found; empty where they are not certain.
        frames: marks that close no loop.
        questions: open decisions, each with the flags that decide it.
    """

    mechanism: Mechanism
    found: Mapping[str, str]
    motors: str
    frames: tuple[str, ...]
    questions: tuple[str, ...]

    @property
    def stated(self) -> tuple[LoopJoint, ...]:
        """The loop joints that the file states."""
        return tuple(joint for joint in self.mechanism.loop_joints if joint.name not in self.found)

    @property
    def doubtful(self) -> list[LoopJoint]:
        """The loop joints whose ends were found by their places."""
        return [loop for loop in self.mechanism.loop_joints if self.found.get(loop.name) in (_MEETING, _MEETING_ENDS)]

    def refused(self, why: str) -> Proposal:
        """Return the proposal with the question that is left where no robot can be made of it, and why not."""
        return self.asking(*(_is_cut(loop.links, "They only meet at zero") for loop in self.doubtful), why)

    def asking(self, *questions: str) -> Proposal:
        """Return the proposal with more questions."""
        return replace(self, questions=(*self.questions, *questions))

    def settled(self, robot: Robot, turning: Collection[str]) -> Proposal:
        """Return the proposal with the questions that only the closed mechanism raises.

        Args:
            robot: made of ``mechanism``, its reference closed.
            turning: names of the loop joints whose links turn against each other about several axes.
        """
        motors, how = self.mechanism.actuated, self.motors
        if how == BY_NAME and set(motors) != set(robot.independent_joints):
            how = ""
        asked, rows = list[str](), {each.name: len(each.axes) for each in robot.closures}
        for loop in self.mechanism.loop_joints:
            ends, flag, held = ",".join(loop.links), _close(loop.links), rows.get(loop.name, 0)
            if self.found.get(loop.name, BY_FLAG) not in (BY_FLAG, BY_NAME) and held < _FEWEST_ROWS:
                asked.append(_is_cut(loop.links, f"Closing it holds {held} direction(s) only"))
            elif self.motors and len(motors) > robot.n and loop in self.doubtful:
                asked.append(_is_cut(loop.links, f"Closing it leaves {robot.n} DOF to {len(motors)} motors"))
            elif loop.name in self.mechanism.presumed and (loop.name in turning or (how and len(motors) < robot.n)):
                kinds, why = ["ball", "weld"], f"With a ball the mechanism has {robot.n} DOF and {len(motors)} motor(s)"
                if loop.name in turning:
                    kinds.insert(1, "hinge")
                    why = "Its links turn about several axes, so a hinge about z of these frames is not a ball"
                ways = " or ".join(f"{flag},{kind}" for kind in kinds)
                if loop.name not in turning and (marks := [mark for mark in self.frames if not _is_frame(mark)]):
                    ways += f", or --close A,B of another loop, of {', '.join(marks)}"
                asked.append(f"Which joint closes the loop at {ends}? {why}: {ways}.")
        if not how:
            asked.append(_which_motors(self.mechanism, robot.n))
        return replace(self, motors=how).asking(*asked)

    def listed(self) -> tuple[str, ...]:
        """Return a line on each loop, the motors, the carriers, and marks that close no loop."""
        loops = [
            f"loop: {each.kind} of {' and '.join(each.links)}, {self.found.get(each.name, 'stated by the file')}"
            for each in self.mechanism.loop_joints
        ]
        motors = f"motors: {', '.join(self.mechanism.actuated)}, {self.motors}" if self.motors else "motors: not known"
        frames = [f"links that close no loop: {', '.join(self.frames)}"] if self.frames else []
        none = (
            "loops: none; where origins of links meet in a joint that the file leaves out, name it: --close A,B; "
            "elsewhere, `closures: [{hinge: [A, B], at: [[...], [...]], axis: z}]` in the robot.yaml"
        )
        carriers = [f"carriers: {', '.join(self.mechanism.carriers)}"] if self.mechanism.carriers else []
        return (*(loops or [none]), motors, *carriers, *frames)


def propose(
    mechanism: Mechanism,
    *,
    close: Sequence[str] = (),
    actuate: Sequence[str] = (),
    carriers: Sequence[str] = (),
    platform: str = "",
    is_open: bool = False,
) -> Proposal:
    """Find the ends of loops and the motors of a mechanism.

    Args:
        mechanism: what a file states.
        close: pairs of links, "a,b", or "a,b,kind"; without a kind they meet in a ball.
        actuate: names of joints.
        carriers: names of joints with an actuated mass that changes the dynamics and not the pose.
        platform: name of the link whose coordinates motions are given in; empty for joints.
        is_open: no other marks are ends of loops.

    Returns:
        The proposal, without the questions that only the closed mechanism raises (``Proposal.settled``).

    Raises:
        InputError: an unknown link, joint or kind.

    Example:
        >>> propose(mechanism, close=["ltip,rtip"], actuate=["a", "c"]).questions
        ()
    """
    given = [_given(mechanism.model, text) for text in close]
    own = {frozenset(joint.links) for joint in given}
    loops = [joint for joint in mechanism.loop_joints if frozenset(joint.links) not in own]
    found = {joint.name: BY_NAME for joint in loops if joint.name in mechanism.presumed}
    is_stated = bool(mechanism.loop_joints)
    presumed = [*found, *(joint.name for joint, text in zip(given, close, strict=True) if text.count(",") == 1)]
    loops += given
    found |= {joint.name: BY_FLAG for joint in given}
    questions = list[str]()
    for name in (*actuate, *carriers):
        find_joint_index(mechanism.model, name)
    if platform:
        find_link(mechanism.model, platform)
    mechanism, motors = _with_motors(replace(mechanism, carriers=tuple(carriers)), actuate)
    if not is_open:
        is_driven = bool(motors) and len(mechanism.actuated) >= mechanism.model.nv - len(mechanism.couplings)
        pairs, questions = _cut_ends(mechanism, loops, is_stated=is_stated, is_driven=is_driven)
        for pair, how in pairs.items():
            joint = _between(pair, "ball")
            loops.append(joint)
            presumed.append(joint.name)
            found[joint.name] = how
    if questions and not motors:  # without its loops a mechanism has another number of degrees of freedom
        questions.append(_which_motors(mechanism))
    ends = {link for joint in loops for link in joint.links}
    complete = replace(mechanism, loop_joints=tuple(loops), presumed=tuple(presumed))
    frames = () if questions else tuple(mark for mark in mechanism.marks if mark not in ends)
    return Proposal(complete, found, motors, frames, tuple(questions))


def _given(model: pin.Model, text: str) -> LoopJoint:
    """Return the joint of "a,b" or "a,b,kind"."""
    names = [part.strip() for part in text.split(",")]
    kind = names.pop() if len(names) == 3 else "ball"
    if len(names) != 2 or names[0] == names[1] or kind not in KINDS:
        remedy = f"Write --close A,B or --close A,B,KIND, with two links and one of {', '.join(KINDS)}."
        raise InputError(f"close = {shown(text)} names no joint between two links.", remedy=remedy, close=text)
    for name in names:
        find_link(model, name)
    return _between((names[0], names[1]), kind)


def _between(pair: tuple[str, str], kind: str) -> LoopJoint:
    return joint_between(" = ".join(pair), kind, pair, [np.eye(4)] * 2, [np.eye(3)[2]] * 2)


def _close(pair: Iterable[str]) -> str:
    return f"--close {','.join(pair)}"


def _is_cut(pair: Iterable[str], why: str) -> str:
    """Return the question whether a loop is cut at a pair of links."""
    return f"Is a loop cut at {','.join(pair)}? {why}: {_close(pair)} or --open."


# --- ends of loops ----------------------------------------------------------------------------------------------------


@lru_cache(maxsize=4096)  # pairs of marks ask for the words of each many times
def _words(name: str) -> tuple[str, ...]:
    """Return the words of a name: "ringTip_12" has ring, tip and 12."""
    return tuple(word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+|\d+", name))


def _difference(one: str, other: str) -> tuple[int, int, frozenset[str]] | None:
    """Return how two names differ in one word, as left_tip and right_tip do; None if they differ otherwise.

    The result is the number of words, the place of that word, and both of its forms.
    """
    words = _words(one), _words(other)
    if len(words[0]) != len(words[1]) or len(words[0]) == 1:
        return None
    different = [(place, pair) for place, pair in enumerate(zip(*words, strict=True)) if pair[0] != pair[1]]
    return (len(words[0]), different[0][0], frozenset(different[0][1])) if len(different) == 1 else None


class _Tree:
    """Where links are when all joints are at zero, and elsewhere."""

    def __init__(self, model: pin.Model) -> None:
        self.model, data = model, model.createData()
        indices = {name: find_link_index(model, name) for name in link_names(model)}
        self.places = dict[str, Array]()
        for q in (pin.neutral(model), pin.integrate(model, pin.neutral(model), np.linspace(0.2, 0.7, model.nv))):
            pin.framesForwardKinematics(model, data, q)
            for name, index in indices.items():
                self.places[name] = np.array([*self.places.get(name, ()), data.oMf[index].translation])
        self.bodies = {name: int(model.frames[index].parentJoint) for name, index in indices.items()}
        self.size = characteristic_length(model, pin.neutral(model), ())

    def meet(self, one: str, other: str, tolerance: float = _COINCIDE) -> bool:
        """Return whether two links meet; see ``meeting``."""
        return bool(self.meeting(one, [other], tolerance))

    def meeting(self, one: str, links: Sequence[str], tolerance: float = _COINCIDE) -> list[str]:
        """Return the links, among some, that meet a link of another body.

        They are at one point when all joints are at zero, and not wherever these are: on the axis of a joint between
        them they always are.
        """
        if not links:
            return []
        places = np.array([self.places[other] for other in links])
        is_near = np.linalg.norm(places - self.places[one], axis=2) <= tolerance * self.size  # at zero, elsewhere
        near = [links[int(number)] for number in np.flatnonzero(is_near[:, 0] & ~is_near[:, 1])]
        return [other for other in near if self.bodies[other] != self.bodies[one]]

    def join(self, joints: Iterable[LoopJoint]) -> set[frozenset[int]]:
        """Return the pairs of bodies that joints join."""
        return {frozenset(self.bodies[link] for link in joint.links) for joint in joints}


def _cut_ends(
    mechanism: Mechanism, loops: Sequence[LoopJoint], *, is_stated: bool, is_driven: bool
) -> tuple[dict[tuple[str, str], str], list[str]]:
    """Return the pairs of marks that are ends of loops, with how they were found, and what has to be asked.

    ``is_stated``: the file has loops, so that marks that are not named as ends are none.
    """
    tree = _Tree(mechanism.model)
    all_marks, joined = _marks(mechanism, tree), tree.join(loops)
    used = {link for joint in loops for link in joint.links}
    marks = [mark for mark in all_marks if mark not in used]
    cuts = [mark for mark in marks if _CUTS.intersection(_words(mark))]
    near = [pair for pair in _apart(cuts, tree) if tree.meet(*pair, _NEARLY)]
    named = near if len(cuts) == 2 else _only_ones(near)
    pairs, questions = dict.fromkeys(named, _MEETING_ENDS), _idle_ends(mechanism, tree, joined)
    used |= {mark for pair in named for mark in pair}
    at_zero = list[tuple[str, str]]()
    for mark in marks:
        meeting = tree.meeting(mark, all_marks)
        bodies = {tree.bodies[other] for other in meeting}
        if mark in used or not bodies or {tree.bodies[mark], *bodies} in joined:
            continue
        if len(bodies) > 1:
            names = ", ".join(sorted({mark, *meeting}))
            questions.append(f"Which of {names} close loops? They are at one point, in three bodies or more.")
        elif not used.intersection(meeting):
            here = [
                other for other in marks if tree.bodies[other] == tree.bodies[mark] and tree.meet(other, meeting[0])
            ]
            pair = min(product(here, meeting), key=lambda each: (not _difference(*each), *map(_is_frame, each)))
            used |= {*here, *meeting}
            is_named = bool(_difference(*pair)) or any(_has(mark, _CUTS | _ENDS) for mark in pair)
            if is_stated or named or not is_named or any(map(_is_frame, pair)):
                questions.append(_is_cut(pair, "They only meet at zero"))
            else:
                at_zero.append(pair)
    likewise = {difference for pair in at_zero if (difference := _difference(*pair))}
    for pair in _only_ones(_apart([mark for mark in marks if mark not in used], tree), likewise):
        used |= {*pair}
        if tree.meet(*pair, _NEARLY):
            pairs[pair] = _MEETING_ENDS
        else:
            questions.append(_is_cut(pair, "Others named so meet"))
    asked = [mark for mark in marks if mark not in used and not _is_frame(mark)]
    if is_stated:  # the file says which marks are ends: the others are none
        asked = [mark for mark in asked if _CUTS.intersection(_words(mark))]
    elif pairs or likewise:  # names say which marks are ends
        alike = {mark for pair in _apart(asked, tree) if _difference(*pair) for mark in pair}
        asked = [mark for mark in asked if mark in alike or (_CUTS | _ENDS).intersection(_words(mark))]
    question, suggests = _which_meet(asked, at_zero, tree)
    words = _CUTS if is_driven else _CUTS | _ENDS  # where every joint is driven, other marks are frames
    if asked and (at_zero or (suggests and not is_driven) or any(_has(mark, words) for mark in asked)):
        frames = [mark for mark in marks if mark not in used and _is_frame(mark)]
        if len(asked) == 1 and frames:  # its other end is named for another use, as a tool is
            question, _ = _which_meet([*asked, *frames], at_zero, tree)
        questions.append(question)
        at_zero = []
    pairs |= dict.fromkeys(at_zero, _MEETING)
    return pairs, sorted(set(questions))


def _marks(mechanism: Mechanism, tree: _Tree) -> list[str]:
    """Return the links that may be ends of loops."""
    light = NO_MASS * pin.computeTotalMass(mechanism.model)
    return [
        mark
        for mark, mass in mechanism.marks.items()
        if mass <= light or (_CUTS | _ENDS).intersection(_words(mark)) or tree.meeting(mark, tuple(mechanism.marks))
    ]


def _idle_ends(mechanism: Mechanism, tree: _Tree, joined: set[frozenset[int]]) -> list[str]:
    """Return questions on links that move, weigh nothing and carry nothing, where they meet another body at zero.

    Such a link may be the far half of a joint of the loop, which is cut at a weld. Coupled rotors are not.
    """
    model, total = tree.model, pin.computeTotalMass(tree.model)
    coupled = {find_joint_index(model, name) for each in mechanism.couplings for name in each.joints}
    carriers = {*model.parents, *coupled}
    idle = {
        link: body
        for link, body in tree.bodies.items()
        if body and body not in carriers and model.inertias[body].mass <= NO_MASS * total and total > 0.0
    }
    pairs = [
        (link, other)
        for link, body in idle.items()
        for other in tree.meeting(link, tuple(tree.bodies))
        if tree.bodies[other] != model.parents[body] and other not in idle
    ]
    return [
        f"Is a loop cut at {','.join(pair)}? The first moves and is massless: {_close(pair)},weld or --open."
        for pair in pairs
        if not any(tree.bodies[pair[0]] in each for each in joined)
    ]


def _has(mark: str, ends: Iterable[str]) -> bool:
    """Return whether a word of a name ends in one of some words."""
    return any(word.endswith(tuple(ends)) for word in _words(mark))


def _is_frame(mark: str) -> bool:
    """Return whether the name of a mark indicates another use than to close a loop."""
    words = set(_words(mark))
    return bool(words & _FRAMES) and not words & _CUTS


def _apart(marks: Sequence[str], tree: _Tree) -> list[tuple[str, str]]:
    """Return the pairs of marks on two bodies."""
    return [pair for pair in combinations(marks, 2) if tree.bodies[pair[0]] != tree.bodies[pair[1]]]


def _only_ones(pairs: Iterable[tuple[str, str]], differences: Collection[Any] | None = None) -> list[tuple[str, str]]:
    """Return the pairs named alike, in one of some ways, whose marks have no other such counterpart."""
    if differences is not None and not differences:
        return []
    found = {pair: _difference(*pair) for pair in pairs}
    alike = [pair for pair, how in found.items() if how and (differences is None or how in differences)]
    count = Counter(mark for pair in alike for mark in pair)
    return [pair for pair in alike if count[pair[0]] == count[pair[1]] == 1]


def _which_meet(marks: Sequence[str], at_zero: Sequence[tuple[str, str]], tree: _Tree) -> tuple[str, bool]:
    """Return the question which of some marks are ends of loops, with what suggests itself; whether anything does."""
    likely = dict.fromkeys(at_zero, "they meet at zero")
    apart = _apart(marks, tree)
    if len(marks) == 2:
        likely |= dict.fromkeys(apart, "the only two")
    alike = (pair for pair in apart if _difference(*pair) and pair not in likely)
    likely |= dict.fromkeys(islice(alike, _MOST_SUGGESTIONS), "named alike")
    own = {*marks}
    others = [link for link in tree.bodies if link not in own]
    for mark in marks:  # a pin that is marked on one of its links only
        for link in tree.meeting(mark, others):
            if tree.model.parents[tree.bodies[link]] != tree.bodies[mark]:
                likely[mark, link] = "it is there at zero"
    suggested = "; ".join(f"{_close(pair)} ({why})" for pair, why in likely.items()) or "--close A,B"
    open_at_zero = bool(likely) and not any(tree.meet(*pair) for pair in likely)
    branch = " Where all joints are at zero they do not meet: name the branch too, --guess JOINT=VALUE,..."
    return (
        f"Where are loops cut? The file does not say which of the links {', '.join(marks)} close loops: {suggested}, "
        f"or --open if none does.{branch if open_at_zero else ''}",
        bool(likely),
    )


# --- motors -----------------------------------------------------------------------------------------------------------


def _with_motors(mechanism: Mechanism, actuate: Sequence[str]) -> tuple[Mechanism, str]:
    """Return the mechanism with its motors, and how they were found; with all joints where that is not known."""
    if actuate:
        return replace(mechanism, actuated=tuple(actuate)), "by --actuate"
    if stated := tuple(name for name in mechanism.actuated if name not in mechanism.carriers):
        how = "marked as independent by the file" if set(stated) <= set(mechanism.independent) else "stated by the file"
        return replace(mechanism, actuated=stated), how
    joints = _could_be_driven(mechanism)
    passive = {name for name in joints if _PASSIVE.intersection(_words(name))}
    named = [name for name in joints if _is_motor(name) and name not in passive]
    others = [name for name in joints if name not in passive]
    if passive and not named:
        named = others
    places = _usual_places(mechanism.model, joints)
    if not named or not (named == others or set(named) <= {name for group in places.values() for name in group}):
        return replace(mechanism, actuated=joints), ""
    notes = (*mechanism.notes, f"The file does not say what is driven: taken are {', '.join(named)}, {BY_NAME}.")
    return replace(mechanism, actuated=tuple(named), notes=notes), BY_NAME


def _is_motor(joint: str) -> bool:
    """Return whether the name of a joint indicates a motor: hip_motor_1 does, motor_side_elbow does not."""
    words = [word for word in _words(joint) if len(word) > 1 and not word.isdigit() and word not in _SIDES]
    return bool(words) and words[-1] in _MOTORS


def _could_be_driven(mechanism: Mechanism) -> tuple[str, ...]:
    """Return the joints of one degree of freedom that follow no other and are no carriers."""
    others = {*mechanism.carriers, *(coupling.joint for coupling in mechanism.couplings)}
    model = mechanism.model
    return tuple(name for name in joint_names(model) if find_joint(model, name).nv == 1 and name not in others)


def _usual_places(model: pin.Model, joints: Sequence[str]) -> dict[str, list[str]]:
    """Return the joints that motors are usually at, by kind."""
    indices = {name: find_joint_index(model, name) for name in joints}
    return {
        "on the ground": [name for name in joints if model.parents[indices[name]] == 0],
        "slides": [name for name in joints if slides(model.joints[indices[name]])],
    }


def _which_motors(mechanism: Mechanism, count: int | None = None) -> str:
    """Return the question which joints are driven, with what suggests itself for a number of degrees of freedom."""
    joints = _could_be_driven(mechanism)
    by_name = [name for name in joints if _is_motor(name)]
    reasons: dict[tuple[str, ...], list[str]] = {}
    for why, names in {"by name": by_name, "all": joints, **_usual_places(mechanism.model, joints)}.items():
        if len(names) == count:
            reasons.setdefault(tuple(names), []).append(why)
    ways = [f"--actuate {','.join(names)} ({', '.join(why)})" for names, why in reasons.items()]
    degrees = "" if count is None else f" The mechanism has {count} DOF."
    letters = ",".join("ABCDEF"[:count]) if count and count <= min(6, len(joints)) else "A,B,..."
    return f"Which joints are driven, of {', '.join(joints)}?{degrees} {'; '.join(ways) or f'--actuate {letters}'}."
