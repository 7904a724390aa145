"""Writing files so that a reader never sees half of one: build beside the target, then rename."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from redundancy_pin.errors import OutputError

MANIFEST = "summary.json"
"""File of a results folder that lists, under the key ``io.files``, everything the folder holds."""


@contextmanager
def replacing_file(target: str | Path) -> Iterator[Path]:
    """Give the path of a temporary file that takes the place of ``target`` when the block ends without an error.

    Whatever goes wrong, ``target`` is as it was before and the temporary file is gone.

    Args:
        target: the file to write; an existing one is replaced.

    Yields:
        A path in the folder of the target, with its suffix (writers choose a format by it).

    Raises:
        OutputError: the folder does not exist or is not writable, or the target is a folder.
    """
    path = Path(target).expanduser()
    require_writable(path)
    with _refusing(path):
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
        os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with _refusing(path):
            # mkstemp makes a file for its owner alone; what the user asked for gets the usual permissions
            temporary.chmod(0o666 & ~_umask())
            os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def require_writable(target: str | Path) -> None:
    """Check that a file can be written, before the work that makes its content is done.

    Raises:
        OutputError: its folder does not exist or is not writable, or it is a folder itself.
    """
    path = Path(target).expanduser()
    _require_folder(path)
    if path.is_dir():
        raise OutputError(f"Cannot write {path}: it is a folder.", remedy="Give the name of a file.", path=str(path))


def write_text(target: str | Path, text: str) -> None:
    """Write a UTF-8 text file, whole or not at all.

    Raises:
        OutputError: as ``replacing_file``.
    """
    with replacing_file(target) as temporary, _refusing(Path(target)):
        temporary.write_text(text, encoding="utf-8", newline="")


@contextmanager
def replacing_folder(target: str | Path) -> Iterator[Path]:
    """Give the path of a temporary folder that takes the place of ``target`` when the block ends without an error.

    An earlier folder of results is replaced as a whole, so that no file of it survives beside those of the new one. It
    counts as such when its ``summary.json`` lists every file in it: a folder with anything else is never touched.

    Args:
        target: the folder to make; missing, empty, or one of earlier results.

    Yields:
        An empty folder beside the target.

    Raises:
        OutputError: as ``require_replaceable``, or the disk refuses; the target is then as it was before.
    """
    path = Path(target).expanduser().resolve()
    require_replaceable(path)
    with _refusing(path):
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
        temporary.chmod(0o777 & ~_umask())
    try:
        yield temporary
        _swap(temporary, path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def require_replaceable(target: str | Path) -> None:
    """Check that a folder of results can be written, before the work that fills it is done.

    Raises:
        OutputError: its parent does not exist or is not writable, it is a file, the current folder or a parent of it,
            or it holds files that are not results.
    """
    path = Path(target).expanduser().resolve()
    _require_folder(path)
    if path.exists() and not path.is_dir():
        raise OutputError(f"Cannot write {path}: it is a file.", remedy="Give the name of a folder.", path=str(path))
    if path == Path.cwd() or path in Path.cwd().parents:
        raise OutputError(
            f"Cannot replace {path}: it is the current folder, or holds it.",
            remedy="Give a folder of its own, such as `results`.",
            path=str(path),
        )
    if path.is_dir():
        foreign = sorted(_files(path) - _listed(path))
        if foreign:
            raise OutputError(
                f"{path} holds {len(foreign)} file(s) that are not results of an earlier run, such as {foreign[0]}.",
                remedy="Nothing was changed: move them, or choose another folder.",
                path=str(path),
                files=tuple(foreign),
            )


def _require_folder(path: Path) -> None:
    parent = path.parent
    if not parent.is_dir():
        raise OutputError(f"Cannot write {path}: there is no folder {parent}.", remedy="Make it first.", path=str(path))
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(
            f"Cannot write {path}: the folder {parent} is not writable.",
            remedy="Choose another place.",
            path=str(path),
        )


@contextmanager
def _refusing(path: Path) -> Iterator[None]:
    """Turn what the disk refuses into an error that names the path."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"Cannot write {path}: {error.strerror or error}.", remedy="Choose another place.", path=str(path)
        ) from error


def _swap(new: Path, target: Path) -> None:
    with _refusing(target):
        if not target.exists():
            os.replace(new, target)
            return
        require_replaceable(target)  # once more: something may have been put there meanwhile
        old = Path(tempfile.mkdtemp(prefix=f".{target.name}-old-", dir=target.parent))
        os.replace(target, old)
        try:
            os.replace(new, target)
        except OSError:
            os.replace(old, target)
            raise
    shutil.rmtree(old, ignore_errors=True)


def _files(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir()}


def _listed(folder: Path) -> set[str]:
    """Return the files that the manifest of a results folder lists, and the manifest; nothing if it has none."""
    try:
        listed = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))["files"]
        return {MANIFEST, *(str(name) for name in listed)}
    except (OSError, ValueError, KeyError, TypeError):
        return set()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
