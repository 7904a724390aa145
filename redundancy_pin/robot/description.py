"""Find a robot's files and render its URDF."""

from __future__ import annotations

import difflib
import threading
from collections.abc import Mapping
from pathlib import Path

from redundancy_pin.errors import ModelFileError
from redundancy_pin.robot.arguments import Argument, as_text, from_text, parsed
from redundancy_pin.robot.inertias import require_inertias, require_no_mimics

_XACRO = threading.Lock()
"""xacro keeps its stacks in globals: two threads at once empty each other's."""


def models_root() -> Path:
    """Return the folder of the shipped models: inside the wheel, or beside the package in a checkout."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "models"
    return inside if inside.is_dir() else package.parent / "models"


def shipped_robots() -> tuple[str, ...]:
    """Return the names of the shipped robots, sorted."""
    return tuple(sorted(path.parent.name for path in models_root().glob("*/robot.yaml")))


def declaration_path(source: str | Path) -> Path:
    """Return the path of a robot's declaration.

    Args:
        source: name of a shipped robot, path of a ``robot.yaml``, or of the folder that holds one.

    Raises:
        ModelFileError: there is no such robot or file.
    """
    if isinstance(source, str) and source in shipped_robots():
        return models_root() / source / "robot.yaml"
    if not isinstance(source, (str, Path)):
        raise ModelFileError(
            f"A robot is named by text or a path, not by {source!r}.",
            remedy=f"Shipped robots: {', '.join(shipped_robots())}.",
        )
    path = Path(source)
    if path.is_dir() and (path / "robot.yaml").is_file():
        return path / "robot.yaml"
    if path.is_file():
        return path
    if path.is_dir():
        raise ModelFileError(
            f"The folder {path} holds no robot.yaml.",
            remedy="Name the declaration itself, or the folder that holds it.",
            source=str(source),
        )
    names = ", ".join(shipped_robots())
    if path.suffix or len(path.parts) > 1:
        raise ModelFileError(
            f"There is no file {path}.",
            remedy=f"Correct the path, or name a shipped robot: {names}.",
            source=str(source),
        )
    close = difflib.get_close_matches(str(source).lower(), shipped_robots(), n=1)
    hint = f"Did you mean {close[0]!r}? " if close else ""
    raise ModelFileError(
        f"There is no robot {str(source)!r}.",
        remedy=f"{hint}Shipped robots: {names}; or pass the path of your own robot.yaml.",
        source=str(source),
    )


def source_of(path: Path) -> str:
    """Return what finds a declaration again from any folder: the name of a shipped robot, or an absolute path."""
    absolute = path.resolve()
    shipped = absolute.name == "robot.yaml" and absolute.parent.parent == models_root().resolve()
    return absolute.parent.name if shipped else str(absolute)


def render(path: Path, arguments: Mapping[str, object]) -> tuple[str, dict[str, Argument]]:
    """Render a URDF or xacro file.

    Args:
        path: a ``.urdf`` or ``.xacro`` file; what it includes is found relative to it.
        arguments: xacro arguments by name, checked by ``arguments.known_values``; those left out keep their defaults.

    Returns:
        The URDF, and every xacro argument with the value that was used.

    Raises:
        ModelFileError: missing file, broken XML, a xacro expression that fails, masses and inertias that are none, or a
            joint that mimics another.
    """
    parsed(path)
    if path.suffix == ".xacro":
        urdf, parameters = _run_xacro(path, {name: as_text(value) for name, value in arguments.items()})
    else:
        urdf, parameters = path.read_text(encoding="utf-8"), {}
    require_inertias(path, urdf)
    require_no_mimics(path, urdf)
    return urdf, parameters


def _run_xacro(path: Path, given: dict[str, str]) -> tuple[str, dict[str, Argument]]:
    import xacro
    from xacrodoc import XacroDoc

    resolved = dict(given)  # xacro adds the arguments that were left out, their defaults evaluated
    try:
        with _XACRO:
            document = xacro.process_file(str(path.resolve()), mappings=resolved)
            text: str = XacroDoc.from_string(
                document.toxml(),
                rootdir=path.parent,
                resolve_packages=False,  # the meshes of a package that is not there are missed by pictures only
            ).to_urdf_string()
    except Exception as error:  # xacro evaluates Python expressions: anything may come out of it
        raise ModelFileError(
            f"xacro cannot render {path}: {type(error).__name__}: {error}",
            remedy="Check the expression and the arguments it uses.",
            path=str(path),
        ) from error
    return text, {name: from_text(str(value)) for name, value in resolved.items()}
