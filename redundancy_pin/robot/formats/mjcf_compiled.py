"""Compile MJCF by MuJoCo's own compiler, and keep of the result what describes a mechanism.

Files are data: they read other files of their own folder only, and what multiplies elements is counted before MuJoCo
sees it. Shapes whose mass does not count are not read, so that meshes and textures may be missing.
"""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.errors import ModelFileError, optional, shown
from redundancy_pin.io.limited import answer, run_limited
from redundancy_pin.io.reading import is_file
from redundancy_pin.robot.formats.xml_files import MOST_ELEMENTS, Element, parsed

MUJOCO = ("mujoco", "Models of MuJoCo (MJCF) need", "Install it with `pip install 'redundancy_pin[mjcf]'`.")
"""What ``errors.optional`` takes."""

_ARRAYS = (
    *("body_parentid", "body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia"),
    *("body_jntadr", "body_jntnum", "body_mocapid", "body_gravcomp", "body_plugin"),
    *("jnt_bodyid", "jnt_qposadr", "jnt_dofadr", "jnt_pos", "jnt_axis", "jnt_limited", "jnt_range"),
    *("jnt_stiffness", "jnt_stiffnesspoly", "jnt_springyield", "jnt_actfrclimited", "jnt_actfrcrange"),
    *("dof_armature", "dof_damping", "dof_dampingpoly", "dof_frictionloss", "qpos0", "qpos_spring"),
    *("site_bodyid", "site_pos", "site_quat", "key_qpos"),
    *("eq_obj1id", "eq_obj2id", "eq_active0", "eq_data"),
    *("tendon_adr", "tendon_num", "tendon_length0", "tendon_limited", "tendon_range", "tendon_stiffness"),
    *("tendon_stiffnesspoly", "tendon_springyield", "tendon_damping", "tendon_dampingpoly", "tendon_frictionloss"),
    *("tendon_armature", "tendon_lengthspring", "tendon_actfrclimited", "tendon_actfrcrange"),
    *("wrap_objid", "wrap_prm"),
    *(
        "actuator_trnid",
        "actuator_gear",
        "actuator_gainprm",
        "actuator_biasprm",
        "actuator_ctrllimited",
        "actuator_ctrlrange",
    ),
    *("actuator_forcelimited", "actuator_forcerange", "actuator_actlimited", "actuator_actrange"),
    *("actuator_damping", "actuator_dampingpoly", "actuator_armature", "actuator_plugin"),
)
"""Those of MuJoCo's model that are kept. Older releases have not all of them: what is missing is zero."""

_WORDS = {
    **{"jnt_type": "Joint", "eq_type": "Eq", "eq_objtype": "Obj", "wrap_type": "Wrap"},
    **{"actuator_trntype": "Trn", "actuator_dyntype": "Dyn", "actuator_gaintype": "Gain", "actuator_biastype": "Bias"},
}
"""Arrays of numbers that stand for words, and the enumeration that has them: "hinge" for mjJNT_HINGE of mjtJoint."""

_NAMED = ("body", "joint", "site", "tendon", "actuator", "equality", "key")

_COUNTS = ("replicate", "composite")
_SHOWN_GROUPS = 3
"""MuJoCo's viewer shows the first groups of geoms; by its convention the others are for contacts."""


@dataclass(frozen=True, eq=False)
class Compiled:
    """A model that MuJoCo compiled.

    Attributes:
        name: of the model.
        arrays: those of MuJoCo's model by their names, with words for the numbers that stand for some; and "gravity"
            (3,), "fluid" (2,) its density and viscosity, "disabled" (N,) the flags that are, "colliding" () whether
            geoms may collide, "flexes" () the number of soft bodies, "warnings" (N,) of MuJoCo.
        names: of its elements, by kind; empty for elements without.
        shapes: of the bodies, by number: elements ``visual`` of a URDF.
    """

    name: str
    arrays: Mapping[str, Any]
    names: Mapping[str, Sequence[str]]
    shapes: Sequence[tuple[int, str]]

    def __getitem__(self, name: str) -> Any:
        """Return an array."""
        return self.arrays[name]

    def has(self, name: str, index: int) -> bool:
        """Return whether an entry is not zero, of an array that not every release of MuJoCo has."""
        array = self.arrays[name]
        return bool(array.ndim and np.any(array[index]))


def compile_mjcf(path: Path, *, trust: bool = False, untrusted: bool = False) -> Compiled:
    """Return what MuJoCo makes of a file.

    Args:
        path: the file.
        trust: let it name files outside of its own folder.
        untrusted: compile in a child process with limits of time and memory.

    Raises:
        ModelFileError: naming the file: it is none, names files elsewhere, or MuJoCo refuses it.
        RedundancyPinError: MuJoCo is not installed.
    """
    optional(*MUJOCO)
    if untrusted:
        return _unpacked(run_limited("redundancy_pin.robot.formats.mjcf_compiled", [str(path)], str(path)))
    _require_bounded(path, trust)
    return _compiled(path, trust)


# --- before MuJoCo sees it --------------------------------------------------------------------------------------------


def _require_bounded(path: Path, trust: bool) -> None:
    """Require that a file includes files of its folder only, and count what it multiplies."""
    folder = path.resolve().parent
    total, read = 0, set[Path]()
    waiting = [(path, 1)]
    while waiting:
        file, times = waiting.pop()
        if file.resolve() in read:
            continue
        read.add(file.resolve())
        for element, count in _multiplied(parsed(file), times):
            total += count
            if total > MOST_ELEMENTS:
                raise _refused(file, element, f"more than {MOST_ELEMENTS} elements, counted as often as they are made")
            if element.tag == "flexcomp":
                raise _refused(file, element, "<flexcomp> is a soft body, which is not covered", "Take it out.")
            if element.tag in ("include", "model") and (named := element.get("file")):
                places = (folder / named, file.parent / named)
                place = next((at for at in places if is_file(at)), places[0])
                if not (trust or _is_within(place, folder)):
                    raise _refused(file, element, f"file={shown(named)} {_OUTSIDE}", _MOVE)
                waiting.append((place, count))


_OUTSIDE = "is outside of the model's folder"
_MOVE = "Move it there, or pass trust=True if you trust the file's author."


def _is_within(place: Path, folder: Path) -> bool:
    try:
        return place.resolve().is_relative_to(folder)
    except (OSError, ValueError, RuntimeError):  # a NUL in the name, links in a circle
        return False


def _multiplied(element: Element, times: int) -> Iterator[tuple[Element, int]]:
    """Give an element and all in it, with how often each is made."""
    if element.tag in _COUNTS:
        for part in element.get("count", "1").split():
            times *= max(1, min(int(part), MOST_ELEMENTS)) if part.isdecimal() else 1
    yield element, times
    for child in element:
        if isinstance(child, Element):
            yield from _multiplied(child, times)


def _refused(file: Path, element: Element, what: str, remedy: str = "Make it smaller.") -> ModelFileError:
    return ModelFileError(
        f"{file}, line {element.line}: {what}.", remedy=remedy, path=str(file), line=int(element.line)
    )


# --- MuJoCo -----------------------------------------------------------------------------------------------------------


def _compiled(path: Path, trust: bool) -> Compiled:
    mujoco = optional(*MUJOCO)
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)  # it writes a file otherwise, and warns of the same in Python
    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            spec = mujoco.MjSpec.from_file(str(path))
            colliding = any(geom.contype or geom.conaffinity for geom in spec.geoms)
            idle = _without_idle_shapes(spec, mujoco.mjtGeom.mjGEOM_SPHERE)
            for mesh in () if trust else spec.meshes:
                if mesh.file and not _is_within(_mesh_file(spec, mesh, path.parent), path.resolve().parent):
                    raise ModelFileError(f"{path}: file={shown(mesh.file)} {_OUTSIDE}.", remedy=_MOVE, path=str(path))
            # bodies stay links by their names, whatever they are welded to
            spec.compiler.fusestatic = spec.compiler.discardvisual = False
            model = spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        said = " ".join(str(error).split()).removeprefix("Error: ").removeprefix("XML Error: ")
        remedy = "Correct it there: MuJoCo does not run it either."
        raise ModelFileError(f"{path}: MuJoCo refuses it: {said}.", remedy=remedy, path=str(path)) from error
    finally:
        mujoco.set_mju_user_warning(before)
    arrays = {name: np.array(getattr(model, name, 0.0)) for name in _ARRAYS}
    for name, enum in _WORDS.items():
        words = [_word(getattr(mujoco, f"mjt{enum}")(int(number))) for number in getattr(model, name)]
        arrays[name] = np.array(words, dtype=str)
    flags = [_word(flag) for flag in mujoco.mjtDisableBit.__members__.values() if model.opt.disableflags & int(flag)]
    arrays |= {
        "gravity": np.array(model.opt.gravity),
        "fluid": np.array([model.opt.density, model.opt.viscosity]),
        "disabled": np.array(flags, dtype=str),
        "colliding": np.array(colliding),
        "flexes": np.array(model.nflex),
        "warnings": np.array([" ".join(str(each.message).split()) for each in warned], dtype=str),
    }
    names = {
        kind: tuple(mujoco.mj_id2name(model, which, number) or "" for number in range(_count(model, kind)))
        for kind in _NAMED
        for which in [getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}")]
    }
    files = {geom.id: (file, scale) for geom, file, scale in idle}
    return Compiled(spec.modelname, arrays, names, list(_shapes(mujoco, model, files)))


def _word(value: Any) -> str:
    return str(value.name).partition("_")[2].lower()


def _count(model: Any, kind: str) -> int:
    return int(getattr(model, {"joint": "njnt", "actuator": "nu", "equality": "neq"}.get(kind, f"n{kind}")))


def _without_idle_shapes(spec: Any, ball: Any) -> list[tuple[Any, str, Array]]:
    """Put balls in the place of meshes whose mass does not count; return these geoms with their files and scales."""
    idle: list[tuple[Any, str, Array]] = []
    meshes = {mesh.name or Path(mesh.file).stem: mesh for mesh in spec.meshes}
    kept = set()
    for geom in spec.geoms:
        geom.material = ""
        if _word(geom.type) not in ("mesh", "sdf", "hfield") and not geom.meshname:
            continue
        if _counts(spec, geom):
            kept.add(geom.meshname)
            continue
        mesh: Any = meshes.get(geom.meshname)
        if mesh is not None and mesh.file and not np.any(mesh.refpos) and abs(mesh.refquat[0]) == 1.0:
            idle.append((geom, str(_mesh_file(spec, mesh, Path())), np.array(mesh.scale)))
        else:
            idle.append((geom, "", np.ones(3)))
        geom.type, geom.meshname, geom.hfieldname, geom.size = ball, "", "", [1.0, 1.0, 1.0]
    for each in (*spec.sites, *spec.tendons):
        each.material = ""
    unused = [mesh for name, mesh in meshes.items() if name not in kept]
    for asset in (*spec.skins, *unused, *spec.hfields, *spec.materials, *spec.textures):
        spec.delete(asset)
    return idle


def _mesh_file(spec: Any, mesh: Any, folder: Path) -> Path:
    return folder / str(getattr(mesh.compiler, "meshdir", "") or spec.meshdir or "") / str(mesh.file)


def _counts(spec: Any, geom: Any) -> bool:
    """Return whether the mass of a body follows from a geom."""
    body, rule = geom.parent, _word(spec.compiler.inertiafromgeom)
    if body.name == "world" or rule == "false" or (rule == "auto" and body.explicitinertial):
        return False
    low, high = spec.compiler.inertiagrouprange
    has_mass = geom.density != 0.0 if math.isnan(geom.mass) else geom.mass != 0.0
    return bool(low <= geom.group <= high and has_mass)


def _shapes(mujoco: Any, model: Any, files: Mapping[int, tuple[str, Array]]) -> Iterator[tuple[int, str]]:
    """Give the shapes of bodies that are shown, as a URDF has them."""
    for number in range(model.ngeom):
        file, scale = files.get(number, ("", np.ones(3)))
        size, kind = model.geom_size[number], _word(mujoco.mjtGeom(int(model.geom_type[number])))
        if model.geom_group[number] >= _SHOWN_GROUPS or (number in files and not file):
            continue
        if file:
            shape = f'mesh filename="{_escaped(file)}" scale="{_numbers(scale)}"'
        elif kind == "box":
            shape = f'box size="{_numbers(2.0 * size)}"'
        elif kind == "sphere":
            shape = f'sphere radius="{float(size[0])!r}"'
        elif kind in ("cylinder", "capsule"):
            shape = f'{kind} radius="{float(size[0])!r}" length="{2.0 * float(size[1])!r}"'
        else:
            continue
        turn = rotation_of(model.geom_quat[number])
        origin = f'xyz="{_numbers(model.geom_pos[number])}" rpy="{_numbers(pin.rpy.matrixToRpy(turn))}"'
        visual = f"<visual><origin {origin}/><geometry><{shape}/></geometry></visual>\n"
        yield int(model.geom_bodyid[number]), visual


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")


def _numbers(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


def rotation_of(wxyz: Array) -> Array:
    """Return the rotation (3, 3) of a quaternion w, x, y, z of any length; of none as MuJoCo does, the identity."""
    length = float(np.linalg.norm(wxyz))
    if length < _SMALLEST:
        return np.eye(3)
    turn: Array = pin.Quaternion(*(float(part) / length for part in wxyz)).toRotationMatrix()
    return turn


_SMALLEST = 1e-15
"""MuJoCo's mjMINVAL: a quaternion that is shorter is no turn."""


# --- from a child process ---------------------------------------------------------------------------------------------


def _packed(path: str) -> bytes:
    _require_bounded(Path(path), trust=False)
    model = _compiled(Path(path), trust=False)
    names = {f"names of {kind}": np.array(names, dtype=str) for kind, names in model.names.items()}
    links = np.array([link for link, _ in model.shapes], dtype=np.intp)
    shapes = np.array([shape for _, shape in model.shapes], dtype=str)
    output = io.BytesIO()
    arrays: dict[str, Any] = {"name": np.array(model.name), "shapes": shapes, "shaped": links, **names, **model.arrays}
    np.savez(output, **arrays)
    return output.getvalue()


def _unpacked(content: bytes) -> Compiled:
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    names = {kind: tuple(map(str, arrays.pop(f"names of {kind}"))) for kind in _NAMED}
    shaped, shapes = arrays.pop("shaped").tolist(), arrays.pop("shapes").tolist()
    return Compiled(str(arrays.pop("name")), arrays, names, list(zip(shaped, shapes, strict=True)))


if __name__ == "__main__":
    answer(_packed)
