"""Writing files and folders so that a reader never sees half of one: write next to the target, then ``os.replace``.

A link stays, and its target is written; an existing file keeps its permissions; a read-only one is left
alone.
"""

from __future__ import annotations

import os
import secrets
import shutil
import stat
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from redundancy_pin.errors import OutputError, shortened
from redundancy_pin.io.reading import LARGEST_TEXT, read_json, read_text

MANIFEST = "summary.json"
"""File of a results folder that lists, under the key ``files``, everything the folder holds."""


@contextmanager
def replacing_file(target: str | Path) -> Iterator[Path]:
    """Give the path of a temporary file that takes the place of ``target`` when the block ends without an error.

    Whatever goes wrong, ``target`` is as it was before and the temporary file is gone.

    Args:
        target: the file to write; an existing one is replaced, and keeps its permissions.

    Yields:
        A path on the same disk, with the suffix of the target (writers choose a format by it).

    Raises:
        OutputError: as ``require_writable``, or the disk refuses.

    Example:
        >>> with replacing_file("plan.csv") as temporary:
        ...     size = temporary.write_text("t, x0")
    """
    path = require_writable(target)
    temporary = _beside(path)
    try:
        with refusing(path):
            temporary.touch(exist_ok=False)  # the kernel applies the umask
            mode = stat.S_IMODE((path if path.exists() else temporary).stat().st_mode)
            temporary.chmod(mode & 0o700)
        yield temporary
        with refusing(path):
            temporary.chmod(mode)
            with temporary.open("rb") as stream:
                os.fsync(stream.fileno())
            os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(target: str | Path, text: str | Iterable[str]) -> None:
    """Write a UTF-8 text file, or the parts of one as they come, whole or not at all.

    Raises:
        OutputError: as ``replacing_file``.
    """
    with replacing_file(target) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
        for part in [text] if isinstance(text, str) else text:  # what makes them may fail of itself
            with refusing(target):
                stream.write(part)
        with refusing(target):
            stream.flush()


@contextmanager
def replacing_folder(target: str | Path) -> Iterator[Path]:
    """Give the path of a temporary folder that takes the place of ``target`` when the block ends without an error.

    An earlier folder of results is replaced as a whole, so that no old file remains among the new ones. A folder counts
    as results if its ``summary.json`` lists every file in it: a folder with anything else is never touched.

    Args:
        target: the folder to make; missing, empty, or one of earlier results.

    Yields:
        An empty folder next to the target.

    Raises:
        OutputError: as ``require_replaceable``, or the disk refuses; the target is then as it was before.
    """
    path = require_replaceable(target)
    temporary, earlier = _beside(path), _beside(path)
    try:
        with refusing(path):
            temporary.mkdir()
        yield temporary
        require_replaceable(path)  # once more: something may have been put there meanwhile
        with refusing(path):
            if path.exists():
                os.replace(path, earlier)
            os.replace(temporary, path)
    finally:
        if earlier.exists() and not path.exists():
            with suppress(OSError):  # then it stays beside the target
                os.replace(earlier, path)
        if path.exists():
            shutil.rmtree(earlier, ignore_errors=True)
        shutil.rmtree(temporary, ignore_errors=True)


def require_writable(target: str | Path) -> Path:
    """Check that a file can be written, before the work that makes its content is done.

    Returns:
        Its path: ``~`` is the user's folder, links are followed.

    Raises:
        OutputError: its folder does not exist or is not writable, it is a folder itself, a device or a pipe, or
            read-only, or no file can have its name.
    """
    path = expanded(target)
    _require_place(path)
    if path.is_symlink():
        path = path.resolve()
        _require_place(path)
    if not path.exists():
        return path
    if not path.is_file():
        what = "a folder" if path.is_dir() else "a pipe or a device"
        raise _refused(path, f"it is {what}.", "Give the name of a file.")
    # for the superuser every file is writable; one without any such permission was still meant to stay as it is
    if not (path.stat().st_mode & 0o222 and os.access(path, os.W_OK)):
        raise _refused(path, "it is read-only.", "Make it writable, or give another name.")
    return path


def require_suffix(path: str | Path, allowed: Sequence[str]) -> str:
    """Return the suffix of a file to write, in lower case.

    Raises:
        OutputError: a suffix that is not among the allowed ones.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in allowed:
        raise _refused(path, f"its name does not end in {' or '.join(allowed)}.", f"Give it the suffix {allowed[0]}.")
    return suffix


def require_replaceable(target: str | Path) -> Path:
    """Check that a folder of results can be written, before the work that fills it is done, and return its path.

    Raises:
        OutputError: its parent does not exist or is not writable, it is a file, the current folder or a parent of it,
            or it holds files that are not results.
    """
    path = expanded(target)
    _require_place(path)
    path = path.resolve()
    _require_place(path)
    if path.exists() and not path.is_dir():
        raise _refused(path, "it is a file.", "Give the name of a folder.")
    if path == Path.cwd() or path in Path.cwd().parents:
        raise _refused(path, "it is the current folder, or holds it.", "Give a folder of its own, such as `results`.")
    held = {each.relative_to(path).as_posix() for each in path.rglob("*") if not each.is_dir()}
    if foreign := sorted(held - _listed(path)):
        raise OutputError(
            f"{path} holds {len(foreign)} file(s) that are not results of an earlier run, such as {foreign[0]}.",
            remedy="Nothing was changed: move them, or choose another folder.",
            path=str(path),
            files=tuple(foreign),
        )
    return path


def _listed(folder: Path) -> set[str]:
    """Return the files that the manifest of a results folder lists, and the manifest; nothing if it has none."""
    try:
        text = read_text(folder / MANIFEST, OutputError, largest=LARGEST_TEXT)
        return {MANIFEST, *(str(name) for name in read_json(text, constants=True)["files"])}
    except (OutputError, ValueError, KeyError, TypeError):
        return set()


def expanded(target: str | Path) -> Path:
    """Return a path to write, ``~`` being the user's folder.

    Raises:
        OutputError: ``~name`` of an unknown user.
    """
    try:
        return Path(target).expanduser()
    except (RuntimeError, TypeError) as error:
        raise _refused(target, str(error), "Write the folder itself.") from error


@contextmanager
def refusing(path: str | Path, kinds: tuple[type[Exception], ...] = (OSError,)) -> Iterator[None]:
    """Turn what the disk refuses into an error that names the path."""
    try:
        yield
    except kinds as error:
        reason = (error.strerror if isinstance(error, OSError) else "") or str(error)
        raise _refused(path, f"{reason}.") from error


def _require_place(path: Path) -> None:
    """Check that a path can be the name of a file or folder, and that its folder can be written to."""
    with refusing(path, (OSError, ValueError, RuntimeError)):  # too long a name, a NUL in it, a loop of links
        with suppress(FileNotFoundError, NotADirectoryError):
            path.stat()
        there = path.parent.is_dir()
    if not there:
        raise _refused(path, f"there is no folder {path.parent}.", "Make it first.")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise _refused(path, f"the folder {path.parent} is not writable.")


def _beside(path: Path) -> Path:
    return path.with_name(f".{secrets.token_hex(8)}{path.suffix}")


def _refused(path: str | Path, why: str, remedy: str = "Choose another place.") -> OutputError:
    return OutputError(f"Cannot write {shortened(str(path))}: {why}", remedy=remedy, path=str(path))
