"""Archives of arrays: what is written is read, and bombs and lies are refused before anything is unpacked."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import time
import warnings
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from redundancy_pin.errors import InputError, PlanFileError
from redundancy_pin.io import archive
from redundancy_pin.io.archive import read_archive, write_archive
from redundancy_pin.io.reading import LARGEST_TEXT, MOST_LISTS

SOON = 10.0
"""Seconds of the processor after which a refusal hangs; how long it takes is in the test in a process of its own."""


@dataclass(frozen=True)
class Numbers:
    """A record."""

    a: Any
    note: Any = ""


def read(path: Path) -> Mapping[str, Any]:
    return read_archive(path, "numbers", 1, "list of numbers", dict)


def text(**record: Any) -> str:
    return json.dumps({"format": "numbers", "format_version": 1, "package_version": "1", "record": record})


def npy(array: Any, **changed: Any) -> bytes:
    """Return a member, its header changed where that is said."""
    stream = io.BytesIO()
    header = {"descr": np.lib.format.dtype_to_descr(array.dtype), "fortran_order": False, "shape": array.shape}
    np.lib.format.write_array_header_1_0(stream, {**header, **changed})
    return stream.getvalue() + array.tobytes()


def pack(path: Path, *members: tuple[str, bytes], packing: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", packing) as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of names that are there already
        for name, content in members:
            file.writestr(zipfile.ZipInfo(name), content, packing, compresslevel=1)
    return path


METADATA = ("metadata.npy", npy(np.array(text(a={"$array": "a"}))))
THREE = np.arange(3.0)


def refused(path: Path, *says: str) -> None:
    begin = time.process_time()
    with pytest.raises(PlanFileError) as caught:
        read(path)
    assert time.process_time() - begin < SOON
    for part in (str(path), *says):
        assert part in str(caught.value)
    assert len(str(caught.value)) < 1500
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "array",
    [
        np.array(3.5),
        np.zeros((0, 4)),
        np.arange(12.0).reshape(3, 4).T,
        np.arange(5, dtype=">i4"),
        np.array(["a", "", "Grübler"]),
        np.array([True, False]),
        np.array([1 + 2j]),
    ],
)
def test_arrays_come_back(array: Any, tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    write_archive(path, "numbers", 1, Numbers(array))
    back = read(path)["a"]
    np.testing.assert_array_equal(back, array)
    assert back.shape == array.shape
    assert back.dtype == array.dtype.newbyteorder("=")
    assert not back.flags.writeable


def test_what_a_bomb_would_look_like_is_written_so_that_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archive, "UNPACKED", 1 << 16)
    path = tmp_path / "a.npz"
    write_archive(path, "numbers", 1, Numbers(np.zeros(1_000_000)))
    assert read(path)["a"].shape == (1_000_000,)
    np.savez_compressed(path, metadata=np.array(text()), a=np.zeros(1_000_000))
    refused(path, "when unpacked, of at most")
    # the text of the record counts too
    write_archive(path, "numbers", 1, Numbers(np.zeros((1 << 13) - 1000), "x" * 20_000))
    assert read(path)["a"].shape == ((1 << 13) - 1000,)
    # a reader makes doubles of flags: eight bytes each, which the writer knows
    write_archive(path, "numbers", 1, Numbers(np.zeros(50_000, dtype=bool)))
    assert read(path)["a"].shape == (50_000,)
    np.savez_compressed(path, metadata=np.array(text()), a=np.zeros(50_000, dtype=np.int8))
    refused(path, "bytes as doubles, of at most")


def test_what_an_earlier_version_packed_is_read(tmp_path: Path) -> None:
    """64 MB of zeros in 60 kB: it packed what is 128 MiB when unpacked."""
    path = tmp_path / "a.npz"
    write_archive(path, "numbers", 1, Numbers(np.zeros(8_000_000)))
    assert path.stat().st_size < 100_000
    assert read(path)["a"].shape == (8_000_000,)


def test_what_could_not_be_read_again_is_not_written(tmp_path: Path) -> None:
    for note in ("x" * LARGEST_TEXT, _nested([], 60), "\ud800", 10**400):
        with pytest.raises(InputError, match="more than a file may hold"):
            write_archive(tmp_path / "a.npz", "numbers", 1, Numbers(THREE, note))
    assert not list(tmp_path.iterdir())


def _members(*members: tuple[str, bytes], packing: int = zipfile.ZIP_DEFLATED) -> Callable[[Path], object]:
    return lambda path: pack(path, METADATA, *members, packing=packing)


def _array(content: bytes) -> Callable[[Path], object]:
    return _members(("a.npy", content))


def _cut(path: Path) -> None:
    pack(path, METADATA, ("a.npy", npy(THREE)))
    path.write_bytes(path.read_bytes()[:-30])


def _long_directory(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as file:
        for i in range(25_000):
            file.writestr(zipfile.ZipInfo(f"{i:060}.npy"), b"")


def _pickled(path: Path) -> None:
    np.savez(path, metadata=np.array(text(a={"$array": "a"})), a=np.array([object, print]), allow_pickle=True)


class _Trap:
    def __reduce__(self) -> tuple[Any, ...]:
        return print, ("a pickle was opened",)


def _pickle_alone(path: Path) -> None:
    stream = io.BytesIO()
    np.save(stream, np.array(_Trap(), dtype=object), allow_pickle=True)
    pack(path, METADATA, ("a.npy", stream.getvalue()))


LIES = {
    "a billion values in four bytes": (_array(npy(THREE, shape=(10**9,))), "damaged"),
    "values beyond any memory": (_array(npy(THREE, shape=(10**15, 10**15))), "damaged"),
    "a negative length": (_array(npy(THREE, shape=(-1, -3))), "damaged"),
    "fewer values than bytes": (_array(npy(THREE, shape=(2,))), "damaged"),
    "no values beside endless ones": (_array(npy(THREE[:0], shape=(0, 10**18, 10**18))), "damaged"),
    "values without bytes": (_array(npy(THREE[:0], shape=(10**12,), descr="<U0")), "damaged"),
    "a truth value for a length": (_array(npy(THREE, shape=(3.0,))), "damaged"),
    "objects": (_array(npy(THREE, descr="|O")), "damaged"),
    "a pickle": (_pickled, "damaged"),
    "a pickle that would print": (_pickle_alone, "damaged"),
    "a record of fields": (_array(npy(THREE, descr=[("x", "<f8")])), "damaged"),
    "dates": (_array(npy(THREE, descr="<M8[s]")), "damaged"),
    "raw bytes": (_array(npy(THREE, descr="|S8")), "damaged"),
    "a header that is code": (_array(npy(THREE).replace(b"(3,)", b"f()+")), "damaged"),
    "a deep header": (_array(b"\x93NUMPY\x01\x00\x10\x27" + b"(" * 10_000), "damaged"),
    "an endless header": (_array(b"\x93NUMPY\x02\x00\xff\xff\xff\x7f" + b" " * 10_000), "damaged"),
    "an unknown version": (_array(b"\x93NUMPY\x09\x00" + npy(THREE)[8:]), "damaged"),
    "no array": (_array(b"hello"), "damaged"),
    "an array cut short": (_array(npy(THREE)[:-4]), "damaged"),
    "an archive cut short": (_cut, "damaged"),
    "a name twice": (_members(("a.npy", npy(THREE)), ("a.npy", npy(THREE + 1))), "damaged"),
    "a path": (_members(("../a.npy", npy(THREE))), "damaged"),
    "a path of Windows": (_members(("..\\a.npy", npy(THREE))), "damaged"),
    "another file": (_members(("run.sh", b"true")), "damaged"),
    "an empty name": (_members((".npy", npy(THREE)), (" ", b"")), "damaged"),
    "a name that clears the screen": (_members(("\x1b[2J.npy", npy(THREE))), "damaged"),
    "another packing": (_members(("a.npy", npy(THREE)), packing=zipfile.ZIP_LZMA), "damaged"),
    "forty thousand members": (_long_directory, "damaged"),
    "metadata that are numbers": (lambda path: pack(path, ("metadata.npy", npy(THREE))), "metadata"),
    "several metadata": (lambda path: pack(path, ("metadata.npy", npy(np.array(["{}", "{}"])))), "metadata"),
    "metadata of no character": (
        lambda path: pack(path, ("metadata.npy", npy(np.array([2**31 - 1], "<u4"), descr="<U1", shape=()))),
        "damaged",
    ),
    "deep metadata": (lambda path: pack(path, ("metadata.npy", npy(np.array("[" * 100_000)))), "nested"),
    "a key twice": (
        lambda path: pack(path, ("metadata.npy", npy(np.array(text(a=1).replace('"a"', '"a": 2, "a"'))))),
        "'a' twice",
    ),
    "deep marks": (
        lambda path: pack(path, ("metadata.npy", npy(np.array(text(a=_nested([], 60)))))),
        "nested",
    ),
}


def _nested(value: Any, depth: int) -> Any:
    for _ in range(depth):
        value = [value]
    return value


@pytest.mark.parametrize("case", LIES)
def test_lies_are_refused(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make, says = LIES[case]
    path = tmp_path / "a.npz"
    make(path)
    refused(path, says)
    assert capsys.readouterr().out == ""


def test_a_size_that_lies_in_the_directory(tmp_path: Path) -> None:
    """The member unpacks to eight times what the directory says: only that much is read, and the sum is wrong."""
    path = pack(tmp_path / "a.npz", METADATA, ("a.npy", npy(np.zeros(1000))))
    content = path.read_bytes()
    true, claimed = len(npy(np.zeros(1000))), len(npy(np.zeros(125)))
    content = content.replace(true.to_bytes(4, "little"), claimed.to_bytes(4, "little"))
    path.write_bytes(content)
    refused(path, "damaged")


BOMBS = {
    "one member of 140 MB": [("a.npy", 140_000_000)],
    "fourteen members of 10 MB": [(f"{i}.npy", 10_000_000) for i in range(14)],
    "metadata of 140 MB": [("metadata.npy", 140_000_000)],
}

READER = """
import sys, time
from pathlib import Path
from redundancy_pin.errors import PlanFileError
from redundancy_pin.planners.plan import load_plan
for path in sys.argv[1:]:
    begin = time.process_time()
    try:
        load_plan(path)
    except PlanFileError as error:
        print(time.process_time() - begin)
# not getrusage: it counts what the process had that started this one
status = Path("/proc/self/status").read_text().split()
print(int(status[status.index("VmHWM:") + 1]) / 1024)
"""

MOST = "[]," * (MOST_LISTS - 1) + "0.1," * ((LARGEST_TEXT - 3 * MOST_LISTS - 10) // 4)
"""Entries of the largest list that is read."""

MOST_SECONDS, MOST_MEGABYTES = 2.0, 500.0
"""Of processor time and of memory, those of Python and its libraries included, that a refusal may take."""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is measured as Linux tells it")
@pytest.mark.long
@pytest.mark.parametrize("names", [list(BOMBS)[:1], list(BOMBS)[1:]])
def test_bombs_take_neither_time_nor_memory(names: list[str], tmp_path: Path) -> None:
    paths = []
    for i, members in enumerate(BOMBS[name] for name in names):
        # nothing but their size is wrong with them
        contents = [(name, npy(np.zeros(size // 8))) for name, size in members]
        paths.append(pack(tmp_path / f"{i}.npz", *contents))
    if len(names) > 1:  # the most that is unpacked: no bomb, but no plan either
        large = ("metadata.npy", npy(np.array(text()))), ("a.npy", npy(np.zeros(16_000_000)))
        paths.append(pack(tmp_path / "large.npz", *large))
        # the metadata that need most memory: as many lists as are read, in as many characters
        paths.append(pack(tmp_path / "metadata.npz", ("metadata.npy", npy(np.array(f"[{MOST}1]")))))
    done = subprocess.run([sys.executable, "-c", READER, *paths], capture_output=True, text=True, check=True)
    *seconds, megabytes = map(float, done.stdout.split())
    assert len(seconds) == len(paths)
    assert max(seconds) < MOST_SECONDS
    assert megabytes < MOST_MEGABYTES


def test_many_characters_and_many_arrays_take_neither_memory_nor_time(tmp_path: Path) -> None:
    text, many = tmp_path / "text.npz", tmp_path / "many.npz"
    np.savez_compressed(text, a=np.full(33_000_000, "\u4e00"), metadata=np.array("{}"))
    with zipfile.ZipFile(many, "w") as archive:
        for i in range(20_000):
            archive.writestr(f"{i}.npy", b"")
    for path in (text, many):
        before = time.process_time()
        with pytest.raises(PlanFileError):
            read_archive(path, "plan", 1, "plan", dict)
        assert time.process_time() - before < 2.0
