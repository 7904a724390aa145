"""Compile MJCF by MuJoCo's own compiler, and keep of the result what describes a mechanism.

Files are data: they read other files of their own folder only, and what multiplies elements is counted before MuJoCo
sees it. Shapes whose mass does not count are not read, so that meshes and textures may be missing.
"""

from __future__ import annotations

import io
import json
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import LARGEST, Array
from redundancy_pin.errors import ModelFileError, optional, shown
from redundancy_pin.io.limited import answer, run_limited
from redundancy_pin.io.reading import is_file
from redundancy_pin.robot.formats.packages import is_within
from redundancy_pin.robot.formats.xml_files import MOST_ELEMENTS, Element, Part, parsed

MUJOCO = ("mujoco", "Models of MuJoCo (MJCF) need", "Install it with `pip install 'redundancy_pin[mjcf]'`.")
"""What ``errors.optional`` takes."""

_KEPT = ("body_", "jnt_", "dof_", "qpos", "site_", "key_qpos", "eq_", "tendon_", "wrap_", "actuator_")
"""How the arrays of MuJoCo's model begin that are read."""

_COUNTS = ("replicate", "composite")
_SHOWN_GROUPS = 3
"""MuJoCo's viewer shows the first groups of geoms; by its convention the others are for contacts."""


@dataclass(frozen=True)
class Compiled:
    """A model that MuJoCo compiled, and content of the file that is not in it.

    Attributes:
        model: MuJoCo's model.
        warnings: of MuJoCo's compiler.
        shapes: elements ``visual`` of a URDF, each with the number of its body.
    """

    model: Any
    warnings: list[str]
    shapes: list[tuple[int, str]]


def word(enum: str, value: Any) -> str:
    """Return the word of an enumeration for a value: "hinge" for mjJNT_HINGE of mjtJoint."""
    return str(getattr(optional(*MUJOCO), f"mjt{enum}")(int(value)).name).partition("_")[2].lower()


def compile_mjcf(path: Path, *, trust: bool = False, untrusted: bool = False) -> Compiled:
    """Return what MuJoCo makes of a file.

    Args:
        path: the file.
        trust: let it name files outside its folder.
        untrusted: compile in a child process with limits of time and memory.

    Raises:
        ModelFileError: naming the file: it is no MJCF, names files elsewhere, or MuJoCo refuses it.
        RedundancyPinError: MuJoCo is not installed.
    """
    optional(*MUJOCO)
    if not untrusted:
        return _compiled(path, trust, _require_bounded(path, trust))
    content = run_limited("redundancy_pin.robot.formats.mjcf_compiled", [str(path)], str(path))
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        assets, rest = {"model.mjb": file["model"].tobytes()}, json.loads(str(file["rest"]))
    return Compiled(optional(*MUJOCO).MjModel.from_binary_path("model.mjb", assets), *rest)


def _packed(path: str) -> bytes:
    """Return a compiled model as bytes: MuJoCo's own form of it, and the rest as JSON."""
    mujoco, compiled, output = optional(*MUJOCO), compile_mjcf(Path(path)), io.BytesIO()
    model = np.zeros(mujoco.mj_sizeModel(compiled.model), dtype=np.uint8)
    mujoco.mj_saveModel(compiled.model, None, model)
    np.savez(output, model=model, rest=json.dumps([compiled.warnings, compiled.shapes]))
    return output.getvalue()


# --- before MuJoCo sees it --------------------------------------------------------------------------------------------


def _require_bounded(path: Path, trust: bool) -> tuple[str, ...]:
    """Return the files that a file includes, by their paths from its folder.

    Raises:
        ModelFileError: it includes files of other folders, or multiplies its elements beyond ``MOST_ELEMENTS``.
    """
    folder = path.resolve().parent
    total, read, included = 0, set[Path](), list[str]()
    waiting = [(path, 1)]
    while waiting:
        file, times = waiting.pop()
        if file.resolve() in read:
            continue
        read.add(file.resolve())
        root = parsed(file)
        included.append(Part(root, file, "", top=path).file)
        for element, count in _multiplied(root, times):
            total += count
            part = Part(element, file, "", top=path)
            if total > MOST_ELEMENTS:
                what = f"{part.file} has more than {MOST_ELEMENTS} elements, counted as often as they are made"
                part.refuse(what, "Make it smaller.")
            if element.tag == "flexcomp":
                part.refuse("<flexcomp> is a soft body, which is not covered", "Take it out.")
            if element.tag in ("include", "model") and (named := element.get("file")):
                places = (folder / named, file.parent / named)
                place = next((at for at in places if is_file(at)), places[0])
                if not (trust or is_within(place, (folder,))):
                    part.refuse(f"file={shown(named)} {_OUTSIDE}", _MOVE)
                waiting.append((place, count))
    return tuple(included[1:])


_OUTSIDE = "is outside of the model's folder"
_MOVE = "Move it there, or pass trust=True if you trust the file's author."


def _multiplied(element: Element, times: int) -> Iterator[tuple[Element, int]]:
    """Give an element and all in it, with how often each is made."""
    if element.tag in _COUNTS:
        for part in element.get("count", "1").split():
            times *= max(1, min(int(part), MOST_ELEMENTS)) if part.isdecimal() else 1
    yield element, times
    for child in element:
        if isinstance(child, Element):
            yield from _multiplied(child, times)


# --- MuJoCo -----------------------------------------------------------------------------------------------------------


def _compiled(path: Path, trust: bool, included: Sequence[str]) -> Compiled:
    mujoco = optional(*MUJOCO)
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)  # it writes a file otherwise, and warns of the same in Python
    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            spec = mujoco.MjSpec.from_file(str(path))
            idle = _without_idle_shapes(spec, mujoco.mjtGeom.mjGEOM_SPHERE)
            for mesh in () if trust else spec.meshes:
                if mesh.file and not is_within(_mesh_file(mesh, path.parent), (path.resolve().parent,)):
                    raise ModelFileError(f"{path}: file={shown(mesh.file)} {_OUTSIDE}.", remedy=_MOVE, path=str(path))
            if spec.compiler.discardvisual:
                spec.copy().compile()  # which MuJoCo refuses where the inertia is that of a shape
            # bodies stay links by their names, whatever they are welded to
            spec.compiler.fusestatic = spec.compiler.discardvisual = False
            model = spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        said = " ".join(str(error).split()).removeprefix("Error: ").removeprefix("XML Error: ")
        if included and ", line 0" in said:  # MuJoCo counts no lines there, and names no file
            said += f" (in a file that it includes: {', '.join(included)})"
        remedy = "Correct it there: MuJoCo does not run it either."
        raise ModelFileError(
            f"{path}: MuJoCo refuses it: {said.rstrip('.!')}.", remedy=remedy, path=str(path)
        ) from error
    finally:
        mujoco.set_mju_user_warning(before)
    read = {name: getattr(model, name) for name in dir(model) if name.startswith(_KEPT)}
    for name, values in {**read, "gravity": model.opt.gravity}.items():
        if isinstance(values, np.ndarray) and not np.abs(values.astype(float)).max(initial=0.0) <= LARGEST:
            what = f"{path}: {name.replace('_', ' ')} has a number beyond {LARGEST:g}"
            raise ModelFileError(f"{what}.", remedy="Correct it.", path=str(path))
    return Compiled(
        model,
        [" ".join(str(each.message).split()) for each in warned],
        list(_shapes(model, {geom.id: (file, scale) for geom, file, scale in idle})),
    )


def _without_idle_shapes(spec: Any, ball: Any) -> list[tuple[Any, str, Array]]:
    """Put balls in the place of meshes whose mass does not count; return these geoms with their files and scales."""
    idle: list[tuple[Any, str, Array]] = []
    meshes = {mesh.name or Path(mesh.file).stem: mesh for mesh in spec.meshes}
    kept = set()
    for geom in spec.geoms:
        geom.material = ""
        if word("Geom", geom.type) not in ("mesh", "sdf", "hfield") and not geom.meshname:
            continue
        if _counts(geom):
            kept.add(geom.meshname)
            continue
        mesh: Any = meshes.get(geom.meshname)
        if mesh is not None and mesh.file and not np.any(mesh.refpos) and abs(mesh.refquat[0]) == 1.0:
            idle.append((geom, str(_mesh_file(mesh, Path())), np.array(mesh.scale)))
        else:
            idle.append((geom, "", np.ones(3)))
        geom.type, geom.meshname, geom.hfieldname, geom.size = ball, "", "", [1.0, 1.0, 1.0]
    for each in (*spec.sites, *spec.tendons):
        each.material = ""
    unused = [mesh for name, mesh in meshes.items() if name not in kept]
    for asset in (*spec.skins, *unused, *spec.hfields, *spec.materials, *spec.textures):
        spec.delete(asset)
    return idle


def _mesh_file(mesh: Any, folder: Path) -> Path:
    return folder / str(mesh.compiler.meshdir or "") / str(mesh.file)


def _counts(geom: Any) -> bool:
    """Return whether the mass of a body follows from a geom."""
    body, compiler = geom.parent, geom.compiler  # of the model that it is attached from
    rule = word("InertiaFromGeom", compiler.inertiafromgeom)
    if body.name == "world" or rule == "false" or (rule == "auto" and body.explicitinertial):
        return False
    low, high = compiler.inertiagrouprange
    has_mass = geom.density != 0.0 if math.isnan(geom.mass) else geom.mass != 0.0
    return bool(low <= geom.group <= high and has_mass)


def _shapes(model: Any, files: Mapping[int, tuple[str, Array]]) -> Iterator[tuple[int, str]]:
    """Give the shapes of bodies that are shown, as a URDF has them."""
    from xml.sax.saxutils import quoteattr  # which imports http and ssl

    for number in range(model.ngeom):
        file, scale = files.get(number, ("", np.ones(3)))
        size, kind = model.geom_size[number], word("Geom", model.geom_type[number])
        if model.geom_group[number] >= _SHOWN_GROUPS or (number in files and not file):
            continue
        if file:
            shape = f'mesh filename={quoteattr(file)} scale="{_numbers(scale)}"'
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


if __name__ == "__main__":
    answer(_packed)
