"""Folders of models: what a file may read, and where packages of ROS are looked for."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

from redundancy_pin.errors import ModelFileError, shortened
from redundancy_pin.io.reading import is_file
from redundancy_pin.robot.formats.xml_files import parsed

_MANIFEST = "package.xml"


def own_folders(path: Path) -> tuple[Path, ...]:
    """Return the folders whose files a model may read: its own, and the package of ROS that it is part of."""
    folder = path.resolve().parent
    package = next((each for each in (folder, *folder.parents) if is_file(each / _MANIFEST)), folder)
    return (folder, package)


def is_within(path: Path, folders: Iterable[Path]) -> bool:
    """Return whether a file is in one of some folders, symbolic links followed; False where they lead nowhere."""
    try:
        place = path.resolve()
    except (OSError, ValueError, RuntimeError):  # a NUL in the name, links in a circle
        return False
    return any(place.is_relative_to(folder) for folder in folders)


def may_include(path: Path, folders: Iterable[Path]) -> bool:
    """Return whether a model may include a file: any in its folders, and elsewhere models by their names.

    Models of robots hold no secrets, and many include ``../common.xacro`` without being part of a package. Symbolic
    links are followed.
    """
    return is_within(path, folders) or path.resolve().suffix in (".xacro", ".urdf")


def package_roots(name: str, folder: Path | None) -> Iterator[Path]:
    """Yield the folders that may be a package, the nearest first; none is opened but to read its ``package.xml``.

    They are the folders above a folder, by their name or the one in their ``package.xml``, folders of that name next to
    these,
    and those that the environment's ``ROS_PACKAGE_PATH`` and ``AMENT_PREFIX_PATH`` point to.

    Args:
        name: of the package.
        folder: where the model is; None without one.
    """
    above = (folder, *folder.parents) if folder else ()
    for place in (*above, *_entries("ROS_PACKAGE_PATH")):
        if name in (place.name, _package_name(place)):
            yield place
        yield place / name
    for prefix in _entries("AMENT_PREFIX_PATH"):
        yield prefix / "share" / name


def find_package(name: str, path: Path) -> Path:
    """Return the folder of a package that a model names: the first of ``package_roots`` with a ``package.xml``.

    Raises:
        ModelFileError: not found; names the folders that were searched.
    """
    # a name, not a way to other folders
    roots = tuple(package_roots(name, path.resolve().parent)) if Path(name).name == name != ".." else ()
    for root in roots:
        if is_file(root / _MANIFEST):
            return root
    raise ModelFileError(
        f"{path} names the package {shortened(name)!r}, which is not found: there is no {_MANIFEST} in "
        f"{', '.join(map(str, roots)) or 'any folder of that name'}.",
        remedy="Put the package beside that of the file, or its folder into ROS_PACKAGE_PATH.",
        path=str(path),
        package=name,
    )


def _entries(variable: str) -> tuple[Path, ...]:
    return tuple(Path(entry).absolute() for entry in os.environ.get(variable, "").split(os.pathsep) if entry)


def _package_name(folder: Path) -> str:
    """Return the name that the ``package.xml`` of a folder declares; empty without one."""
    with suppress(ModelFileError):
        if is_file(folder / _MANIFEST):
            return (parsed(folder / _MANIFEST).findtext("name") or "").strip()
    return ""
