import csv

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


def test_carrier_columns(tmp_path):
    header = ["t", "x0", "xd0", "xdd0", *_names(["s", "sd", "sdd"], 2)]
    carriers = carriers_from_csv(_write(tmp_path / "m.csv", header, [range(10), range(1, 11)]))
    np.testing.assert_array_equal(carriers.s, [[4, 5], [5, 6]])
    np.testing.assert_array_equal(carriers.sdd, [[8, 9], [9, 10]])
    with pytest.raises(InputError, match="has no column 'sdd0'"):
        carriers_from_csv(_write(tmp_path / "b.csv", ["t", "s0", "sd0"], [[0, 1, 2]]))
    with pytest.raises(InputError, match=r"2 columns s0, \.\.\. and 1 columns sd0"):
        carriers_from_csv(_write(tmp_path / "c.csv", ["t", "s0", "s1", "sd0", "sdd0"], [[0, 1, 2, 3, 4]]))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has 0 rows of numbers"),
        ("t,x0,xd0,xdd0\n", "has 0 rows of numbers"),
        ("x0,xd0,xdd0\n1,2,3\n", "has no column 't'; its columns are 'x0', 'xd0', 'xdd0'"),
        ("t;x0;xd0;xdd0\n1;2;3;4\n", "has no column 't'|is not a finite number"),
        ("t,x0,xd0\n1,2,3\n", "has no column 'xdd0'; its columns are 't', 'x0', 'xd0'"),
        ("t,x0,x2,xd0,xd1,xdd0\n1,2,3,4,5,6\n", "has no column 'x1'"),
        ("t,x0,x1,xd0,xdd0\n1,2,3,4,5\n", "has 2 columns x0, ... and 1 columns xd0"),
        ("t,x0,xd0,xdd0,xdd1\n1,2,3,4,5\n", "has 1 columns xd0, ... and 2 columns xdd0"),
        ("t,x0,xd0,xdd0\n0,1,2,3\n1,2,abc,4\n", "row 3, column 'xd0': 'abc' is not a finite number"),
        ("t,x0,xd0,xdd0\n0,1,2,nan\n", "row 2, column 'xdd0': 'nan' is not a finite number"),
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
    with pytest.raises(InputError, match=r"Cannot read .*none\.csv: No such file"):
        from_csv(tmp_path / "none.csv")
    with pytest.raises(InputError, match="Cannot read"):
        from_csv(tmp_path)
    binary = tmp_path / "m.csv"
    binary.write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(InputError, match="is not a text file"):
        from_csv(binary)
