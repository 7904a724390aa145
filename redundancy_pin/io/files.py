"""Writing files so that a reader never sees half of one: build beside the target, then rename.

What a link leads to is written, and the link stays; an existing file keeps its permissions; a read-only one is left
alone. Temporary folders are locked while something is written into them: those of a writer that was killed are not, and
the next writer into the same folder removes them.
"""

from __future__ import annotations

import errno
import glob
import os
import secrets
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from redundancy_pin.errors import OutputError, shortened
from redundancy_pin.io.reading import LARGEST_TEXT, read_json, read_text

MANIFEST = "summary.json"
"""File of a results folder that lists, under the key ``files``, everything the folder holds."""

# What a name that is too long, a NUL in it, and a loop of links raise
_BAD_NAME = (OSError, ValueError, RuntimeError)
# Names of their own, so that no other files are taken for leftovers; the second holds an earlier folder of results
_TEMPORARY, _EARLIER = ".redundancy_pin-", ".redundancy_pin_earlier-"
# What network file systems without locks answer: leftovers stay there, as their owner is not known
_NO_LOCKS = (errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK)
_LONGEST_NAME = 150  # bytes of a folder's name in that of its earlier version, which must not get too long for a name


@contextmanager
def replacing_file(target: str | Path) -> Iterator[Path]:
    """Give the path of a temporary file that takes the place of ``target`` when the block ends without an error.

    Whatever goes wrong, ``target`` is as it was before and the temporary file is gone.

    Args:
        target: the file to write; an existing one is replaced, and keeps its permissions.

    Yields:
        A path on the same disk, with the name of the target (writers choose a format by its suffix).

    Raises:
        OutputError: as ``require_writable``, or the disk refuses.
    """
    path = require_writable(target)
    with ExitStack() as stack:
        with refusing(path):
            # in a folder of its own: writers may rename over the file, which would lose a lock on it
            temporary = stack.enter_context(temporary_folder(path.parent)) / path.name
            # the kernel applies the umask: reading it otherwise means to set it, for all threads of the process
            temporary.touch(0o666)
            usual = temporary.stat().st_mode
            temporary.chmod(0o600)
        yield temporary
        with refusing(path):
            _give_permissions(temporary, path, usual)
            os.replace(temporary, path)


def require_writable(target: str | Path) -> Path:
    """Check that a file can be written, before the work that makes its content is done.

    Returns:
        Its path: ``~`` is the user's folder, links are followed.

    Raises:
        OutputError: its folder does not exist or is not writable, it is a folder itself, a device or a pipe, or
            read-only, or no file can have its name.
    """
    path = expanded(target)
    with refusing(path, _BAD_NAME):
        path = path.resolve() if path.is_symlink() else path
        mode = _mode(path)
        _require_folder(path)
    if mode is None:
        return path
    if not stat.S_ISREG(mode):
        what = "a folder" if stat.S_ISDIR(mode) else "a pipe or a device"
        raise _refused(path, f"it is {what}.", "Give the name of a file.")
    # for the superuser every file is writable; one without any such permission was still meant to stay as it is
    if not (mode & 0o222 and os.access(path, os.W_OK)):
        raise _refused(path, "it is read-only.", "Make it writable, or give another name.")
    return path


def write_text(target: str | Path, text: str | Iterable[str]) -> None:
    """Write a UTF-8 text file, or the parts of one as they come, whole or not at all.

    Raises:
        OutputError: as ``replacing_file``.
    """
    with replacing_file(target) as temporary:
        parts = iter([text] if isinstance(text, str) else text)
        with refusing(Path(target)):
            stream = temporary.open("w", encoding="utf-8", newline="")
        with stream:
            for part in parts:  # what makes them may fail of itself
                with refusing(Path(target)):
                    stream.write(part)
            with refusing(Path(target)):
                stream.flush()


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
    path = require_replaceable(target)
    _restore(path)
    with ExitStack() as stack:
        with refusing(path):
            temporary = stack.enter_context(temporary_folder(path.parent, 0o777))
        yield temporary
        _swap(temporary, path)


def require_replaceable(target: str | Path) -> Path:
    """Check that a folder of results can be written, before the work that fills it is done, and return its path.

    Raises:
        OutputError: its parent does not exist or is not writable, it is a file, the current folder or a parent of it,
            or it holds files that are not results.
    """
    path = expanded(target)
    with refusing(path, _BAD_NAME):
        path = path.resolve()
        mode = _mode(path)
        _require_folder(path)
    if mode is not None and not stat.S_ISDIR(mode):
        raise _refused(path, "it is a file.", "Give the name of a folder.")
    if path == Path.cwd() or path in Path.cwd().parents:
        raise _refused(path, "it is the current folder, or holds it.", "Give a folder of its own, such as `results`.")
    if mode is not None and (foreign := sorted(_files(path) - _listed(path))):
        raise OutputError(
            f"{path} holds {len(foreign)} file(s) that are not results of an earlier run, such as {foreign[0]}.",
            remedy="Nothing was changed: move them, or choose another folder.",
            path=str(path),
            files=tuple(foreign),
        )
    return path


def expanded(target: str | Path) -> Path:
    """Return a path to write, ``~`` being the user's folder.

    Raises:
        OutputError: there is no such user.
    """
    try:
        return Path(target).expanduser()
    except (RuntimeError, TypeError) as error:
        raise _refused(target, str(error), "Write the folder itself.") from error


def _refused(path: str | Path, why: str, remedy: str = "Choose another place.") -> OutputError:
    return OutputError(f"Cannot write {shortened(str(path))}: {why}", remedy=remedy, path=str(path))


def _mode(path: Path) -> int | None:
    """Return kind and permissions of a path; None where nothing is there."""
    try:
        return path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None


def _require_folder(path: Path) -> None:
    parent = path.parent
    if not parent.is_dir():
        raise _refused(path, f"there is no folder {parent}.", "Make it first.")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise _refused(path, f"the folder {parent} is not writable.")


@contextmanager
def refusing(path: str | Path, kinds: tuple[type[Exception], ...] = (OSError,)) -> Iterator[None]:
    """Turn what the disk refuses into an error that names the path."""
    try:
        yield
    except kinds as error:
        reason = (error.strerror if isinstance(error, OSError) else "") or str(error)
        raise _refused(path, f"{reason}.") from error


def _give_permissions(temporary: Path, target: Path, usual: int) -> None:
    """Give a file those of the one it replaces, or the usual ones: until now only its owner may read and write it."""
    try:
        there = target.stat()
    except FileNotFoundError:
        temporary.chmod(stat.S_IMODE(usual))
        return
    with suppress(PermissionError):  # only the superuser can give files away
        if sys.platform != "win32":
            os.chown(temporary, there.st_uid, there.st_gid)
    temporary.chmod(stat.S_IMODE(there.st_mode))


# --- what a writer that was killed leaves ---------------------------------------------------------------------------


@contextmanager
def temporary_folder(parent: Path, mode: int = 0o700) -> Iterator[Path]:
    """Give a new folder that is removed at the end, or by the next call for ``parent`` if this process is killed.

    Args:
        parent: the folder to make it in.
        mode: its permissions, less those of the umask.

    Raises:
        OSError: it cannot be made.
    """
    remove_leftovers(parent)
    folder, lock = _made_locked(parent, mode)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _unlock(lock)


def remove_leftovers(folder: Path) -> None:
    """Remove temporary folders whose process has ended without removing them: their locks are free."""
    for left in folder.glob(f"{_TEMPORARY}*"):
        with suppress(OSError, RecursionError):  # in use, or deeper than Python goes
            if not _own(left):
                continue
            lock = _lock(left)
            try:
                if lock is not None:
                    shutil.rmtree(left)
            finally:
                _unlock(lock)


def _own(path: Path) -> bool:
    """Return whether a file or folder, not a link to it, belongs to this user."""
    return sys.platform == "win32" or path.lstat().st_uid == os.geteuid()


def _made_locked(parent: Path, mode: int) -> tuple[Path, int | None]:
    """Make a temporary folder and lock it; once more where another process has removed it in between."""
    while True:
        path = parent / f"{_TEMPORARY}{secrets.token_hex(8)}"
        path.mkdir(mode)
        with suppress(FileNotFoundError):
            lock = _lock(path, wait=True)
            try:
                if lock is None or os.path.samestat(os.fstat(lock), path.stat()):
                    kept, lock = lock, None
                    return path, kept
            finally:
                _unlock(lock)


def _lock(path: Path, *, wait: bool = False) -> int | None:
    """Return the open handle of a folder, locked until it is closed; None where system or disk have no such locks.

    Raises:
        OSError: there is nothing, or (without ``wait``) somebody else has locked it.
    """
    if sys.platform == "win32":
        return None
    import fcntl

    # a pipe of that name would keep us waiting for its writer
    handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_DIRECTORY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError as error:
        os.close(handle)
        if error.errno in _NO_LOCKS:
            return None
        raise
    return handle


def _unlock(lock: int | None) -> None:
    if lock is not None:
        os.close(lock)


def _restore(target: Path) -> None:
    """Bring back an earlier folder whose successor never took its place, or remove the rest of one that is replaced."""
    for earlier in target.parent.glob(f"{glob.escape(_earlier(target))}*"):
        with suppress(OSError):
            lock = _lock(earlier)
            if lock is not None:
                shutil.rmtree(earlier) if target.exists() else os.replace(earlier, target)
                _unlock(lock)


def _earlier(target: Path) -> str:
    """Return how names of the earlier version of a folder begin, while a new one takes its place."""
    return f"{_EARLIER}{os.fsencode(target.name)[:_LONGEST_NAME].decode(errors='ignore')}-"


def _swap(new: Path, target: Path) -> None:
    with refusing(target):
        if not target.exists():
            os.replace(new, target)
            return
        require_replaceable(target)  # once more: something may have been put there meanwhile
        # locked, so that no writer restores it between the two renames; a lock stays with a folder that is renamed
        lock = _lock(target, wait=True)
        try:
            old = Path(tempfile.mkdtemp(prefix=_earlier(target), dir=target.parent))
            os.replace(target, old)
            try:
                os.replace(new, target)
            except OSError:
                os.replace(old, target)
                raise
            shutil.rmtree(old, ignore_errors=True)
        finally:
            _unlock(lock)


def _files(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir()}


def _listed(folder: Path) -> set[str]:
    """Return the files that the manifest of a results folder lists, and the manifest; nothing if it has none."""
    try:
        text = read_text(folder / MANIFEST, OutputError, largest=LARGEST_TEXT)
        return {MANIFEST, *(str(name) for name in read_json(text, constants=True)["files"])}
    except (OutputError, ValueError, KeyError, TypeError):
        return set()
