import csv
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from redundancy_pin.errors import InputError
from redundancy_pin.trajectory import carriers_from_csv, from_csv, reference


def _write(path, header, rows):
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(header)
        writer.writerows(rows)
    return path


def _names(prefixes, count):
    return [f"{prefix}{k}" for prefix in prefixes for k in range(count)]


def test_round_trip_keeps_every_bit_and_the_jumps(tmp_path):
    motion = reference.corner().sample(0.05)
    rows = np.column_stack([motion.t, motion.x, motion.xd, motion.xdd])
    path = _write(
        tmp_path / "m.csv", ["t", *_names(["x", "xd", "xdd"], 3)], [[repr(float(v)) for v in row] for row in rows]
    )
    read = from_csv(str(path))
    for name in ("t", "x", "xd", "xdd", "jumps"):
        assert np.array_equal(getattr(read, name), getattr(motion, name))
    assert carriers_from_csv(path) is None


def test_columns_in_any_order_with_others_beside(tmp_path):
    path = tmp_path / "m.csv"
    path.write_text("\ufeffxd0, note ,x0,t,xdd0\n3,7,2,0,4\n\n3,7,2.5,1,4\n", encoding="utf-8")
    motion = from_csv(path)
    np.testing.assert_array_equal(motion.x, [[2.0], [2.5]])
    np.testing.assert_array_equal(motion.xdd, [[4.0], [4.0]])


def test_more_than_ten_columns_are_sorted_by_number(tmp_path):
    header = ["t", *_names(["x", "xd", "xdd"], 12)]
    motion = from_csv(_write(tmp_path / "m.csv", header, [range(37), range(1, 38)]))
    np.testing.assert_array_equal(motion.x[0], np.arange(1, 13))


def test_poses_as_position_and_quaternion(tmp_path):
    header = ["t", *_names(["x"], 7), *_names(["xd", "xdd"], 6)]
    half = np.sqrt(0.5)
    path = _write(tmp_path / "m.csv", header, [[t, 1, 2, 3, 0, 0, half, half, *range(12)] for t in (0, 1)])
    expected = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]  # a quarter turn about z
    motion = from_csv(path)
    np.testing.assert_allclose(motion.x[0], expected, atol=1e-15)
    bad = _write(tmp_path / "b.csv", header, [[0.0, 1, 2, 3, 0, 0, 1, 1, *range(12)]])
    with pytest.raises(InputError, match=r"quaternion x3\.\.x6 of sample 0 has norm 1\.414"):
        from_csv(bad)


@pytest.mark.parametrize(("factor", "norm"), [(0.5, "0.5"), (2.0, "2"), (1.0 - 1e-5, "0.99999")])
def test_the_sample_whose_quaternion_is_farthest_from_a_unit_is_named(tmp_path, factor, norm):
    header = ["t", *_names(["x"], 7), *_names(["xd", "xdd"], 6)]
    rows = [[t, 1, 2, 3, 0, 0, 0, 1.0 if t != 1 else factor, *range(12)] for t in range(3)]
    with pytest.raises(InputError, match=rf"sample 1 has norm {norm}\.\s"):
        from_csv(_write(tmp_path / "m.csv", header, rows))
    rows[1][7] = 1.0 + 5e-7  # six digits pass
    assert len(from_csv(_write(tmp_path / "m.csv", header, rows), check_rates=False)) == 3


def test_carrier_columns(tmp_path):
    header = ["t", "x0", "xd0", "xdd0", *_names(["s", "sd", "sdd"], 2)]
    carriers = carriers_from_csv(_write(tmp_path / "m.csv", header, [range(10), range(1, 11)]))
    np.testing.assert_array_equal(carriers.s, [[4, 5], [5, 6]])
    np.testing.assert_array_equal(carriers.sdd, [[8, 9], [9, 10]])
    with pytest.raises(InputError, match="has no column 'sdd0'"):
        carriers_from_csv(_write(tmp_path / "b.csv", ["t", "s0", "sd0"], [[0, 1, 2]]))
    with pytest.raises(InputError, match="has no column 'sd1'"):
        carriers_from_csv(_write(tmp_path / "c.csv", ["t", "s0", "s1", "sd0", "sdd0"], [[0, 1, 2, 3, 4]]))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has 0 rows of numbers"),
        ("t,x0,xd0,xdd0\n", "has 0 rows of numbers"),
        ("x0,xd0,xdd0\n1,2,3\n", "has no column 't'; its columns are 'x0', 'xd0', 'xdd0'"),
        ("t;x0;xd0;xdd0\n1;2;3;4\n", "one column, 't;x0;xd0;xdd0': semicolons are between its names. Put commas"),
        ("t;x0;xd0;xdd0\n0,5;2;3;4\n", "semicolons are between its names"),
        ("t\tx0\txd0\txdd0\n1\t2\t3\t4\n", "tabs are between its names"),
        ("t x0 xd0 xdd0\n1 2 3 4\n", "blanks are between its names"),
        ("0,1,2,3\n1,2,2,3\n", "begins with numbers, '0, 1, 2, 3', where the names of its columns should stand"),
        ("t,x0,xd0\n1,2,3\n", "has no column 'xdd0'; its columns are 't', 'x0', 'xd0'"),
        ("t,x0,x2,xd0,xd1,xdd0\n1,2,3,4,5,6\n", "has no column 'x1'"),
        ("t,x0,x1,xd0,xdd0\n1,2,3,4,5\n", "has no column 'xd1'"),
        ("t,x0,xd0,xdd0,xdd1\n1,2,3,4,5\n", "has no column 'x1'"),
        ("t,x0,xd0,xdd0\n0,1,2,3\n1,2,abc,4\n", "row 3, column 'xd0': 'abc' is not a finite number"),
        ("t,x0,xd0,xdd0\n0,1,2,nan\n", "row 2, column 'xdd0': 'nan' is not a finite number"),
        ("t,x0,xd0,xdd0\n0,1e101,2,3\n", "row 2, column 'x0': '1e101' is not a finite number"),
        ("t,x0,xd0,xdd0\n0,1,2,3\n1,1_0,2,3\n", "row 3, column 'x0': '1_0' is not a finite number"),
        ("t,x0,xd0,xdd0\n0,\u0663,2,3\n", "row 2, column 'x0': '\u0663' is not a finite number"),
        ("t,x0,xd0,xdd0\n\n0,1,,3\n", "row 3, column 'xd0': '' is not a finite number"),
        ("t,x0,xd0,xdd0\n0,1,2\n", "row 2: 3 cells under 4 column names"),
        ("t,t,xd0,xdd0\n0,1,2,3\n", "has the column 't' more than once"),
        ("t,x0,xd0,xdd0\n1,0,0,0\n0,0,0,0\n", "Time does not increase"),
    ],
)
def test_bad_files_are_refused(tmp_path, text, message):
    path = tmp_path / "m.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        from_csv(path)


def test_missing_and_binary_files_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"none\.csv cannot be read: it does not exist"):
        from_csv(tmp_path / "none.csv")
    with pytest.raises(InputError, match="it is a folder"):
        from_csv(tmp_path)
    binary = tmp_path / "m.csv"
    binary.write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(InputError, match="is not text in UTF-8"):
        from_csv(binary)


@pytest.mark.parametrize(
    "name", ["x00", "x01", "x٣", "x99999999999999999999", "x" + "9" * 5000, "x1.0", "x-1", "x", ""]
)
def test_names_that_are_nearly_those_of_columns(name, tmp_path):
    path = _write(tmp_path / "m.csv", ["t", name, "xd0", "xdd0"], [[k, 0, 0, 0] for k in range(3)])
    with pytest.raises(InputError, match="no column 'x0'"):
        from_csv(path)


@pytest.mark.parametrize(("read", "wrong"), [(from_csv, "xd0"), (carriers_from_csv, "sd0")])
def test_rates_of_other_units_are_refused_by_column_unless_told_otherwise(read, wrong, tmp_path):
    t = np.linspace(0.0, 2.0, 101)
    wave = {"": np.sin(t), "d": np.cos(t), "dd": -np.sin(t)}
    table = {"t": t, **{f"{symbol}{dots}0": part for symbol in "xs" for dots, part in wave.items()}}
    rows = [[repr(float(value)) for value in row] for row in np.column_stack(list(table.values()))]
    assert len(read(_write(tmp_path / "m.csv", table, rows))) == 101
    table[wrong] = 1e3 * table[wrong]
    rows = [[repr(float(value)) for value in row] for row in np.column_stack(list(table.values()))]
    other = _write(tmp_path / "w.csv", table, rows)
    with pytest.raises(InputError, match=rf"w\.csv: {wrong[0]}0 does not change as {wrong} says") as caught:
        read(other)
    assert caught.value.details["column"] == wrong
    assert len(read(other, check_rates=False)) == 101


def test_a_long_file_takes_little_more_memory_than_its_numbers(tmp_path: Path) -> None:
    t = np.arange(20_000) * 1e-3
    path = tmp_path / "long.csv"
    np.savetxt(
        path, np.column_stack([t, np.sin(t), np.cos(t), -np.sin(t)]), delimiter=",", header="t,x,xd,xdd", comments=""
    )
    tracemalloc.start()
    try:
        motion = from_csv(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    np.testing.assert_allclose(motion.x[:, 0], np.sin(t), rtol=0.0, atol=1e-15)
    assert peak < 8 * (4 * 8 * len(t))  # numbers, copies of them, and what compares the rates; as text 30 times
