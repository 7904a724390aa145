"""Where robots are: the shipped ones by their names, and anybody's by the path of a declaration."""

from __future__ import annotations

import os
from pathlib import Path, PurePosixPath

from redundancy_pin.errors import ModelFileError, did_you_mean, shown
from redundancy_pin.io.reading import is_file


def models_root() -> Path:
    """Return the folder of the shipped models: inside the wheel, or next to the package in a checkout."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "models"
    return inside if inside.is_dir() else package.parent / "models"


_GALLERY = "gallery"
"""The folder of worked examples among the shipped models."""


def shipped_robots(*, gallery: bool = True) -> tuple[str, ...]:
    """Return the names of the shipped robots, sorted; the worked examples of the gallery may be left out."""
    return tuple(sorted(PurePosixPath(name).name for name in shipped_sources() if gallery or "/" not in name))


def shipped_sources() -> tuple[str, ...]:
    """Return what names each shipped robot whatever folders there are: ``2rpr``, ``gallery/delta``."""
    root = models_root()
    declarations = (path for pattern in ("*/robot.yaml", f"{_GALLERY}/*/robot.yaml") for path in root.glob(pattern))
    return tuple(path.parent.relative_to(root).as_posix() for path in declarations)


def source_in(folder: Path, source: str) -> str:
    """Return what finds a robot that a file in a folder names; somebody's own comes before the gallery."""
    own = folder / source
    if source in shipped_sources() or Path(source).is_absolute():
        return source
    if source in shipped_robots() and not (is_file(own) or is_file(own / "robot.yaml")):
        return f"{_GALLERY}/{source}"
    return str(own)


def declaration_path(source: str | Path) -> Path:
    """Return the path of a declaration, given the name of a shipped robot, that path, or the folder that holds it.

    Raises:
        ModelFileError: no robot or file of that name.
    """
    if isinstance(source, str) and source in shipped_sources():
        return models_root() / source / "robot.yaml"
    if not isinstance(source, (str, Path)):
        raise ModelFileError(
            f"A robot is named by text or a path, not by {shown(source)}.",
            remedy=f"Shipped robots: {', '.join(shipped_robots())}.",
        )
    path, names = Path(source), ", ".join(shipped_robots())
    if is_file(path) or is_file(path / "robot.yaml"):
        return path if is_file(path) else path / "robot.yaml"
    if isinstance(source, str) and source in shipped_robots():  # a folder of that name, somebody's own, comes first
        return models_root() / _GALLERY / source / "robot.yaml"
    if os.path.isdir(path):
        message = f"The folder {path} holds no robot.yaml."
        remedy = "Name the declaration itself, or the folder that holds it."
    elif path.suffix or len(path.parts) > 1:
        message, remedy = f"There is no file {path}.", f"Correct the path, or name a shipped robot: {names}."
    else:
        hint = did_you_mean(str(source).lower(), shipped_robots())
        message = f"There is no robot {str(source)!r}."
        remedy = f"{hint}Shipped robots: {names}; or pass the path of your own robot.yaml."
    raise ModelFileError(message, remedy=remedy, source=str(source))


def source_of(path: Path) -> str:
    """Return what finds a declaration again from any folder: one of ``shipped_sources``, or an absolute path."""
    absolute = path.resolve()
    if absolute.name == "robot.yaml" and is_shipped(path):
        return absolute.parent.relative_to(models_root().resolve()).as_posix()
    return str(absolute)


def is_shipped(path: Path) -> bool:
    """Return whether a file is one of a shipped robot, which does not change while a process runs."""
    return path.resolve().parent.parent in (root := models_root().resolve(), root / _GALLERY)
