"""Elements of SDF, the files that include one another, and the frames in them.

A world or a model is a scope of names; ``arm::hand`` is the name ``hand`` in the model ``arm``. Links, joints, models
and ``<frame>`` elements are frames. Each is placed relative to another one (``relative_to``) and moves with another one
(``attached_to``), so that the frames make two graphs: http://sdformat.org/tutorials?tut=pose_frame_semantics.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import ClassVar

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.errors import did_you_mean, shortened, shown
from redundancy_pin.io.reading import is_file
from redundancy_pin.robot.formats.mechanism import MOST_LINKS, not_understood
from redundancy_pin.robot.formats.packages import is_within
from redundancy_pin.robot.formats.xml_files import DRAKE, LONGEST_NAME, MOST_ELEMENTS, Part, parsed
from redundancy_pin.robot.loop_joints import placed

WORLD = "world"
"""Name of the frame that does not move."""

_OLDEST = 3
"""Version 1.3: files of older ones have other elements."""

_LEVELS = 4
"""Folders above a file in which models are looked for: deeper collections are not in use."""

_MODELS_OF_GAZEBO = ("ground_plane", "sun")
"""Models that come with Gazebo and that do not move: worlds include them from its own folders."""

_AXIS = ("xyz", "limit", "dynamics", "mimic", "use_parent_model_frame", "initial_position")
_PARTS = {
    "world": (
        *("joint", "frame", "model", "include", "gravity", "physics", "scene", "light", "gui", "plugin", "audio"),
        *("wind", "magnetic_field", "atmosphere", "spherical_coordinates", "road", "actor", "state", "population"),
    ),
    "model": (
        *("link", "joint", "frame", "model", "include", "pose", "static", "self_collide", "allow_auto_disable"),
        *("enable_wind", "plugin", "gripper", "model_state"),
    ),
    "include": ("uri", "name", "namespace", "static", "pose", "placement_frame", "plugin"),
    "frame": ("pose",),
    "link": (
        *("pose", "inertial", "visual", "collision", "self_collide", "kinematic", "gravity", "enable_wind", "sensor"),
        *("velocity_decay", "light", "must_be_base_link", "audio_sink", "audio_source", "projector", "battery"),
        "particle_emitter",
    ),
    "inertial": ("pose", "mass", "inertia", "density"),
    "inertia": ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"),
    "joint": (
        *("pose", "parent", "child", "axis", "axis2", "physics", "sensor", "gearbox_ratio", "gearbox_reference_body"),
        *("thread_pitch", "screw_thread_pitch"),
    ),
    "axis": _AXIS,
    "axis2": _AXIS,
    "limit": ("lower", "upper", "effort", "velocity", "stiffness", "dissipation"),
    "dynamics": ("damping", "friction", "spring_reference", "spring_stiffness"),
    "mimic": ("multiplier", "offset", "reference"),
}
"""Children that each element may have. Others are errors; those of another namespace are ignored with a note."""


@dataclass(frozen=True)
class SdfPart(Part):
    """An element of SDF, whose numbers and names are the texts of the elements in it.

    Attributes:
        version: 7 in a file of version 1.7.
    """

    version: int = 0
    remedy: ClassVar[str] = "Take it out, or write the model without it."

    def text(self, tag: str, default: str | None = None) -> str:
        """Return the text of an element in the element.

        Raises:
            ModelFileError: it is missing and has no default, or it is there twice or holds elements.
        """
        part = self.one(tag)
        if part is None or len(part.element):
            if part is None and default is not None:
                return default
            (part or self).refuse(f"{self.owner} has no text in <{tag}>", "Add it.")
        return part.content()

    def value(self, tag: str, default: float | None = None) -> float:
        """Return the number of an element in the element; one that is empty has its default, as in Gazebo."""
        if default is not None and not self.says(tag):
            return default
        part = self.one(tag)
        return float((part or self.required(tag)).numbers(self.text(tag), 1, f"the {tag}")[0])

    def says(self, tag: str) -> bool:
        """Return whether an element is in the element, and not empty."""
        part = self.one(tag)
        return part is not None and bool(part.content() or len(part.element))

    def flag(self, tag: str, *, default: bool = False) -> bool:
        """Return whether an element in the element is true."""
        text = self.text(tag, "").lower() or str(default).lower()
        if text not in ("0", "1", "false", "true"):
            self.refuse(f"{self.owner} has <{tag}> {shown(text)}", "Write true or false.")
        return text in ("1", "true")

    def relative_to(self) -> str:
        """Return the name of the frame that the pose of the element is in; empty for the default frame."""
        pose = self.one("pose")
        return (pose.text_of("relative_to") or pose.text_of("frame")) if pose else ""

    def pose(self) -> Array:
        """Return the (4, 4) placement that the <pose> of the element gives, whatever frame it is relative to.

        Its rotation is R_z R_y R_x of roll, pitch and yaw, rad or degrees, or a quaternion x, y, z, w.
        """
        pose = self.one("pose")
        if pose is None:
            return np.eye(4)
        form, degrees = pose.text_of("rotation_format") or "euler_rpy", pose.text_of("degrees").lower() or "false"
        others = set(pose.attributes) - {"relative_to", "rotation_format", "degrees"}
        if pose.version <= 6 or not pose.text_of("frame"):  # the older name of relative_to
            others -= {"frame"}
        if others or form not in ("euler_rpy", "quat_xyzw") or degrees not in ("0", "1", "false", "true"):
            said = ", ".join(f"{key}={shortened(text)!r}" for key, text in sorted(pose.attributes.items()))
            pose.refuse(f"{self.owner} has a pose with {said}", "Use relative_to, rotation_format and degrees.")
        is_quaternion = form == "quat_xyzw"
        text = pose.content() or ("0 0 0 0 0 0 1" if is_quaternion else "0 0 0 0 0 0")
        values = pose.numbers(text, 7 if is_quaternion else 6, "a pose")
        if not is_quaternion:
            turn = np.deg2rad(values[3:]) if degrees in ("1", "true") else values[3:]
            return placed(pin.rpy.rpyToMatrix(turn), values[:3])
        if degrees in ("1", "true") or not np.any(values[3:]):
            pose.refuse(f"{self.owner} has a quaternion in degrees, or of length zero", "Correct it.")
        return placed(pin.Quaternion(values[3:] / np.linalg.norm(values[3:])).toRotationMatrix(), values[:3])


@dataclass(frozen=True)
class Scope:
    """A world or a model, as the place where names are looked up.

    Attributes:
        prefix: first part of the full names in it.
        frame: full name of its frame.
        is_static: whether nothing in it moves.
        canonical: name in it of the link that its frame is attached to; empty for the first one.
        links, models: full names of its links and models, in the order of the file.
    """

    prefix: str
    frame: str
    is_static: bool = False
    canonical: str = ""
    links: list[str] = field(default_factory=list)
    models: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Frame:
    """A frame of a file.

    Attributes:
        full: its full name.
        part: the element with its pose.
        scope: where the names of other frames are looked up.
        attached_to: name of the frame that it moves with; empty for the scope's.
        relative_to: name of the frame that its pose is in, likewise.
        inner: the scope that a model is.
        placement: name of the frame in a model that the pose places; empty for the frame of the model.
    """

    full: str
    part: SdfPart
    scope: Scope
    attached_to: str
    relative_to: str
    inner: Scope | None = None
    placement: str = ""


class Frames:
    """All frames of a file and of those that it includes, by full names.

    Example:
        >>> frames = Frames(Path("machine.sdf"))                          # doctest: +SKIP
        >>> frames.place("machine::arm", "machine")                       # doctest: +SKIP

    Attributes:
        links, joints: elements and their scopes, by full names; links of static models are not among them.
        marks: full names of the ``<frame>`` elements.
        main: full name of the model that moves.
        gravity: (3,) m/s².
        notes: on ignored elements.
    """

    def __init__(self, path: Path) -> None:
        self.links: dict[str, Frame] = {}
        self.joints: dict[str, Frame] = {}
        self.marks: list[str] = []
        self.notes: list[str] = []
        self._frames: dict[str, Frame] = {}
        self._places: dict[str, dict[str, Array]] = {}
        self._elements = 0
        self._open: list[Path] = [path.absolute()]
        self._files: dict[Path, SdfPart] = {}
        self._found: dict[tuple[Path, str], Path | None] = {}
        world = Scope("", WORLD)
        top = self._top_of(path.absolute())
        self.gravity = np.array([0.0, 0.0, -9.81])
        if top.tag == "model":
            self._add_model(world, top)
        elif top.tag == "world":
            self._read(world, top)
            self.gravity = _gravity_of(top)
        else:
            top.refuse(f"{path.name} holds a <{top.tag}>", "Pass a file with one <model> or one <world>.")
        if world.links:
            top.refuse(f"{top.owner} has links beside its models", "Put them in a model.")
        moving = self._leave_out_objects([name for name in world.models if self.body(name) != WORLD])
        if len(moving) != 1:
            what = f"{len(moving)} models that move, {', '.join(moving[:5])}" if moving else "no model that moves"
            top.refuse(f"{top.owner} has {what}" + ("" if moving else ": it is static"), "Leave one that moves.")
        self.main = moving[0]
        in_world = self.place(self.main, WORLD)
        self._places[self.main] = {self.main: np.eye(4), WORLD: np.asarray(np.linalg.inv(in_world))}

    def _leave_out_objects(self, moving: list[str]) -> list[str]:
        """Return the models that move, without those that have no joints if one has: they are no mechanisms."""
        jointed = [name for name in moving if any(full.startswith(f"{name}::") for full in self.joints)]
        if len(jointed) != 1 or jointed == moving or any("::" not in full for full in self.joints):
            return moving
        others = ", ".join(name for name in moving if name not in jointed)
        self.notes.append(f"Passed over: the models without joints, {others}.")
        self.links = {full: frame for full, frame in self.links.items() if full.startswith(f"{jointed[0]}::")}
        return jointed

    def name(self, full: str) -> str:
        """Return what to call a frame: its name in the model that moves."""
        return full.removeprefix(f"{self.main}::")

    # --- files --------------------------------------------------------------------------------------------------------

    def _top_of(self, path: Path) -> SdfPart:
        """Return the world or model of a file, or a light or actor if it holds nothing else."""
        if path not in self._files:
            root = SdfPart(parsed(path), path, "", top=self._open[0])
            root = replace(root, owner=root.file)
            if root.tag != "sdf":
                root.refuse(
                    f"The top element of {root.file} is <{shortened(root.tag)}>, not <sdf>", "Pass an SDF model."
                )
            major, minor, *_ = (*_version(root.text_of("version")), 0, 0)
            if major != 1 or not _OLDEST <= minor < 100:
                what = f"{root.file} is SDF of version {shown(root.text_of('version'))}"
                root.refuse(what, f"Write it as version 1.{_OLDEST} or newer.")
            tops = replace(root, version=minor).parts()
            tops = [top for top in tops if top.tag in ("world", "model")] or tops
            if len(tops) != 1 or tops[0].tag not in ("world", "model", "light", "actor"):
                names = ", ".join(f"<{shortened(top.tag)}>" for top in tops[:5]) or "nothing"
                root.refuse(f"{root.file} holds {names}", "Pass a file with one <model> or one <world>.")
            self._files[path] = tops[0]
        self._elements += sum(1 for _ in self._files[path].element.iter())
        if self._elements > MOST_ELEMENTS:
            part = self._files[path]
            what = f"{part.file} makes it more than {MOST_ELEMENTS} elements with all that is included"
            part.refuse(what, "A model has no use for so many.")
        return self._files[path]

    def _include(self, scope: Scope, part: SdfPart) -> None:
        """Add what another file holds."""
        wanted = part.path, part.text("uri")
        if wanted not in self._found:
            self._found[wanted] = self._find_file(scope, part)
        path = self._found[wanted]
        if path is None:
            return
        if path in self._open:
            part.refuse(f"{self._files[path].file} includes itself", "Take the include out.")
        top = self._top_of(path)
        if top.tag in ("light", "actor") and scope.frame == WORLD:
            return
        if top.tag != "model":
            part.refuse(f"{top.file}, which it includes, holds <{shortened(top.tag)}>", "Include a model.")
        self._open.append(path)
        self._add_model(scope, top, part)
        self._open.pop()

    def _find_file(self, scope: Scope, part: SdfPart) -> Path | None:
        """Return the file that an include names: next to the including file, or in a folder of a model.

        Folders of models are searched next to the file and in the folders above it, and in ``models`` there.
        """
        uri = part.text("uri")
        name = PurePosixPath(uri.removeprefix("model://"))
        if "://" in uri.removeprefix("model://") or name.is_absolute() or ".." in name.parts or not name.parts:
            what = f"{part.owner} includes {shown(uri)}, which is not beside it"
            part.refuse(what, "Put the file there, or write model://NAME; nothing else is read.")
        folder = part.path.absolute().parent
        looked = [above / sub for above in (folder, *folder.parents)[: _LEVELS + 1] for sub in ("", "models")]
        for place in looked:
            model, file = place / name.parts[0], place / name
            if is_file(model / "model.config"):
                file = self._file_of_model(part, file) if file.is_dir() else file
                inside = model
            elif place == folder and is_file(file):
                inside = folder
            else:
                continue
            if not is_within(file, (inside.resolve(),)):
                part.refuse(f"{part.owner} includes {shown(uri)}, which leads out of {inside}", "Put the file there.")
            return file
        if scope.frame == WORLD and name.parts[-1] in _MODELS_OF_GAZEBO:
            self.notes.append(f"Passed over: {part.place}, {uri}, which comes with Gazebo and does not move.")
            return None
        where = f"Looked for {name.parts[0]}/model.config in {', '.join(map(str, looked))}."
        part.refuse(f"{part.owner} includes {shown(uri)}, which is not there", where)

    def _file_of_model(self, part: SdfPart, folder: Path) -> Path:
        """Return the file of the newest version that the model.config of a folder names."""
        config = Part(parsed(folder / "model.config"), folder / "model.config", "The model.config")
        files = {_version(each.text_of("version")): each.content() for each in config.parts("sdf")}
        if not files:
            part.refuse(f"{folder / 'model.config'} names no <sdf>", "Add it.")
        return folder / files[max(files)]

    # --- scopes -------------------------------------------------------------------------------------------------------

    def _read(self, scope: Scope, whole: SdfPart) -> None:
        """Add the content of a world or model."""
        self._check(whole, deep=not scope.is_static)
        if whole.tag == "model" and whole.flag("enable_wind"):
            whole.refuse(f"{whole.owner} is in the wind, which is not covered")
        for part in whole.parts():
            if part.tag == "link":
                full = scope.prefix + _checked_name(part)
                self._add(frame := Frame(full, part, scope, "", part.relative_to()))
                scope.links.append(full)
                if not scope.is_static:
                    self.links[full] = frame
            elif part.tag == "frame":
                full, attached_to = scope.prefix + _checked_name(part), part.text_of("attached_to")
                self._add(Frame(full, part, scope, attached_to, part.relative_to() or attached_to))
                self.marks.append(full)
            elif part.tag == "model":
                self._add_model(scope, part)
            elif part.tag == "include":
                self._include(scope, part)
            elif part.tag in ("plugin", "gripper"):
                self.notes.append(f"The {part.tag} {part.text_of('name')!r} does not run.")
            elif part.tag in ("state", "model_state", "population"):
                self.notes.append(f"Not read: {part.place}. Links are where their own poses put them.")
        for part in whole.parts("joint"):
            full, child = scope.prefix + _checked_name(part), part.text("child")
            if full in self.joints:
                part.refuse(f"{part.owner} has a name that is taken", "Choose another.")
            # before 1.7 a link and a joint may have one name; it is that of the link where frames are named
            own = f"{full} (joint)" if part.version <= 6 and full in self._frames else full
            self._add(frame := Frame(own, part, scope, child, part.relative_to() or child))
            if not scope.is_static:
                self.joints[full] = frame

    def _add_model(self, outer: Scope, model: SdfPart, include: SdfPart | None = None) -> None:
        """Add a model and its content, with the name, pose and flags of the include that it comes from."""
        name = _checked_name(model, include.text("name", "") if include else "")
        placement = (include.text("placement_frame", "") if include else "") or model.text_of("placement_frame")
        if include and include.one("placement_frame") and not include.one("pose"):
            include.refuse(f"{include.owner} has placement_frame, but no pose", "Add the pose.")
        placed_by = include if include and include.one("pose") else model
        static_by = include if include and include.one("static") else model
        merges = include is not None and include.text_of("merge").lower() in ("1", "true")
        full = outer.prefix + (f"_merged__{name}__model__" if merges else name)
        prefix, is_static = outer.prefix if merges else f"{full}::", outer.is_static or static_by.flag("static")
        inner = Scope(prefix, full, is_static, model.text_of("canonical_link"))
        self._add(Frame(full, placed_by, outer, "", placed_by.relative_to(), inner, placement))
        self._read(inner, model)
        outer.models.extend(inner.models if merges else [full])
        outer.links.extend(inner.links if merges else [])

    def _add(self, frame: Frame) -> None:
        part = frame.part
        if frame.full in self._frames:
            part.refuse(f"{part.owner} has a name that is taken", "Choose another.")
        if len(self._frames) >= 3 * MOST_LINKS:
            part.refuse(f"{part.file} has more than {3 * MOST_LINKS} frames", "Take out what is not needed.")
        self._frames[frame.full] = frame

    def _check(self, part: SdfPart, *, deep: bool) -> None:
        """Check an element and its content, except other models, against ``_PARTS``; note elements of other namespaces.

        Raises:
            ModelFileError: an element that SDF does not know, or one of Drake, which may change the mechanics.
        """
        known = _PARTS[part.tag]
        for each in part.parts():
            if each.tag not in known:
                name = shortened(each.tag.rpartition(":")[2])
                if ":" not in each.tag or each.tag.startswith(DRAKE):
                    each.refuse(f"{part.owner} has <{name}>, which is not covered", did_you_mean(name, known).strip())
                self.notes.append(f"{not_understood(each.place).rstrip('.')} ({each.file}).")
            elif deep and each.tag in _PARTS and each.tag != "model":
                has_name = each.tag in ("link", "joint", "frame", "include")
                self._check(each if has_name else replace(each, owner=part.owner), deep=True)

    # --- both graphs --------------------------------------------------------------------------------------------------

    def find(self, scope: Scope, name: str, part: SdfPart) -> str:
        """Return the full name of the frame that a name means in a scope.

        Args:
            scope: where the name is written.
            name: the name; empty or ``__model__`` for the frame of the scope.
            part: the element with the name, for messages.

        Raises:
            ModelFileError: the scope has no frame of that name.
        """
        if name == WORLD and (scope.frame == WORLD or part.tag == "joint"):
            return WORLD
        full = scope.prefix + name.removesuffix(_OF_MODEL)
        if name in ("", "__model__"):
            full = scope.frame
        elif full not in self._frames:
            known = [each.removeprefix(scope.prefix) for each in self._frames if each.startswith(scope.prefix)]
            remedy = did_you_mean(name, known).strip() or "Name a link, joint, frame or model that is beside it."
            part.refuse(f"{part.owner} names {shown(name)}, which is no frame there", remedy)
        return full

    def place(self, full: str, within: str) -> Array:
        """Return the (4, 4) placement of a frame in another one, all joints being where the file has them.

        Args:
            full: its full name.
            within: full name of ``main``, or of a model that the frame is in.

        Raises:
            ModelFileError: poses that are relative to one another in a circle.
        """
        places = self._places.setdefault(within, {within: np.eye(4)})
        above: dict[str, str] = {}
        at = full
        while at not in places:
            frame = self._frames.get(at)
            if frame is None or at in above:
                part = self._frames[full].part
                what = "leads back to itself" if frame else f"leads out of {within!r}"
                part.refuse(f"The pose of {full!r} is relative to a frame whose own pose {what}", "Break the circle.")
            above[at] = at = self.find(frame.scope, frame.relative_to, frame.part)
        for each in reversed(above):
            frame = self._frames[each]
            pose = frame.part.pose()
            if frame.inner and frame.placement:
                marked = self.find(frame.inner, frame.placement, frame.part)
                pose = pose @ np.linalg.inv(self.place(marked, each))
            places[each] = places[above[each]] @ pose
        return places[full]

    def end(self, joint: Frame, role: str) -> str:
        """Return the full name of the link that the "parent" or "child" of a joint moves with, or "world"."""
        name = joint.part.text(role)
        return WORLD if name == WORLD else self.body(self.find(joint.scope, name, joint.part))

    def body(self, full: str) -> str:
        """Return the full name of the link that a frame moves with; "world" if it does not move.

        Raises:
            ModelFileError: frames that are attached to one another in a circle.
        """
        passed: dict[str, None] = {}
        while full != WORLD and full not in self.links:
            frame = self._frames[full]
            if full in passed:
                frame.part.refuse(
                    f"The frame {full!r} is attached to itself, by {', '.join(passed)}", "Break the circle."
                )
            passed[full] = None
            inner = frame.inner
            if frame.scope.is_static or (inner and inner.is_static):
                full = WORLD
            elif inner and inner.canonical:
                full = self.find(inner, inner.canonical, frame.part)
            elif inner:
                if not (first := [*inner.links, *inner.models][:1]):
                    frame.part.refuse(f"The model {full!r} has no links", "Give it one.")
                (full,) = first
            else:
                full = self.find(frame.scope, frame.attached_to, frame.part)
        return full


_OF_MODEL = "::__model__"
"""Suffix by which a name means the frame of a model."""


def _checked_name(part: SdfPart, given: str = "") -> str:
    """Return the name of an element, or the one that is given in its place.

    Raises:
        ModelFileError: none, one of SDF's own, or one with ``::``, which flattened models of version 1.7 have.
    """
    name = given or part.name()
    is_taken = name in (WORLD, "universe") or (name.startswith("__") and name.endswith("__"))
    if is_taken or not name.isprintable() or len(name) > LONGEST_NAME or ("::" in name and part.version > 7):
        part.refuse(f"{part.owner} has the name {shown(name)}, which SDF does not allow", "Choose another.")
    return name.removesuffix(_OF_MODEL)


def _gravity_of(world: SdfPart) -> Array:
    """Return (3,) the gravity of a world, m/s²: before 1.6 it is among the settings of the physics."""
    for part in (world, *world.parts("physics")):
        if given := part.one("gravity"):
            return given.numbers(given.content(), 3, "gravity")
    return np.array([0.0, 0.0, -9.8])


def _version(text: str) -> tuple[int, ...]:
    """Return the numbers of a version such as 1.10."""
    return tuple(int(number) if number.isdecimal() else 0 for number in text.split("."))
