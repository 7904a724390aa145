"""The rule by which a stated number counts as reproduced, the grids, and the data file."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import fields

import numpy as np
import pytest
import quick_results
from hypothesis import given
from hypothesis import strategies as st

from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.thesis.cases import BY_NAME, CORNERS, CROSSINGS, FULL, QUICK, Case, Plans
from redundancy_pin.thesis.in_words import IN_WORDS
from redundancy_pin.thesis.measures import MEASURES, read
from redundancy_pin.thesis.statements import (
    ROUNDING,
    compare_motions,
    excess,
    given_by,
    grid,
    interval,
    judge_all,
    limits_of,
    sensitivity,
    thesis,
    variations,
)

number = st.floats(-1e3, 1e3)


@pytest.mark.parametrize(
    ("digits", "low", "high"), [("2.6", 2.55, 2.65), ("0.20", 0.195, 0.205), ("1", 0.5, 1.5), ("3.0", 2.95, 3.05)]
)
def test_digits_show_how_a_number_was_rounded(digits: str, low: float, high: float) -> None:
    assert interval(digits) == pytest.approx((low, high), abs=1e-12)


def test_an_order_of_magnitude_is_a_factor_of_ten_wide() -> None:
    low, high = interval("~0.01")
    assert high / low == pytest.approx(10.0)
    assert math.sqrt(low * high) == pytest.approx(0.01)


@given(st.lists(number, min_size=1, max_size=6), st.floats(0.01, 100.0), st.booleans(), st.data())
def test_the_gap_is_the_distance_from_the_range(
    values: list[float], beyond: float, above: bool, data: st.DataObject
) -> None:
    low, high = limits_of(values)
    assert excess(f"{data.draw(st.floats(low, high)):.4f}", low, high) <= ROUNDING
    # six digits are printed
    assert excess(f"{high + beyond if above else low - beyond:.6f}", low, high) == pytest.approx(beyond, abs=2e-6)


def test_numbers_stated_together_come_from_one_run() -> None:
    assert given_by(["0.5", "0.9"], (0.52, 0.9))
    assert not given_by(["0.5", "0.9"], (0.52, 2.9))
    assert not given_by(["0.38"], (0.37,))
    assert given_by(["0.38"], (0.37,), late=0.01)
    assert not given_by(["0.38"], (0.40,), late=0.01)  # never earlier


GRIDS = [
    ({"ramp_length": [0.4, 0.5]}, CROSSINGS[0], {"path_options"}, 2),
    ({"ramp_length": [0.4, 0.6]}, CORNERS[0], {"path_options"}, 2),
    ({"return_time": [0.2, 0.3]}, CROSSINGS[0], {"options"}, 2),
    ({"dt": [1e-2]}, CORNERS[0], {"dt"}, 1),
    ({"dt": [1e-2, 2e-2], "return_time": [0.2, 0.3]}, CORNERS[0], ("dt", "options"), 4),
    ({"threshold": [7.0]}, CROSSINGS[0], {"options"}, 1),
    ({"ramp_down": [0.02]}, CROSSINGS[0], {"options"}, 1),
    ({"working_mode": [(-1, -1, -1)]}, CORNERS[0], {"working_mode"}, 1),
    ({"alpha": [0.3]}, CORNERS[0], {"path_options"}, 1),
]


@pytest.mark.parametrize(("values", "case", "allowed", "count"), GRIDS, ids=lambda value: str(value)[:30])
def test_only_what_is_named_changes(
    values: dict[str, list[object]], case: Case, allowed: Collection[str], count: int
) -> None:
    varied = variations(case, values)
    assert len(varied) == count
    for variation, label in varied:
        assert label
        changed = {entry.name for entry in fields(case) if getattr(case, entry.name) != getattr(variation, entry.name)}
        assert changed
        assert changed <= set(allowed)


def test_ramp_lengths_are_fractions_of_speed_times_duration() -> None:
    """v T is 0.5 m/s · 0.2 s on the circle and 0.2 m/s · 0.4 s on the corner."""
    half = {"ramp_length": [0.5]}
    assert variations(CROSSINGS[0], half)[0][0].option("ramp_length") == pytest.approx(0.05)
    assert variations(CORNERS[0], half)[0][0].option("ramp_length") == pytest.approx(0.04)


def test_the_data_file_names_what_exists() -> None:
    data = thesis()
    for entry in (*data["motions"], *data["planned"]):
        assert entry["case"] in BY_NAME
        assert entry["measure"][0] in MEASURES
    for entry in data["planned"]:
        assert entry["row"] in data["rows"]
        assert all(variations(BY_NAME[entry["case"]], grid(name, FULL)) for name in entry["grids"])
        assert all(isinstance(digits, str) for digits in entry["stated"])  # 0.20 is not 0.2
    of_lines = {"3.21-3.22"}  # judged together
    judged = {entry["row"] for entry in data["planned"]} | {statement.row for statement in IN_WORDS} | of_lines
    assert judged == set(data["rows"])


def test_numbers_of_a_crossing_are_read_off_its_motion_and_its_plan() -> None:
    """Figure 3.16: 0.26 s and 0.67 s, 4.2 N and 5.0 N as the forces fall, 0.46 N and 0.50 N on switching on."""
    keys = ("row", "case", "stated", "measure", "grids", "late")
    of_plan = [tuple(entry.get(key) for key in keys) for entry in thesis()["planned"] if entry["source"] == "fig. 3.16"]
    case, ramps = "circle-0.75-cn5", "fast_circle_ramps"
    assert of_plan == [
        ("3.16 entry", case, ["0.26"], ["time_of", "entry"], [ramps], 0.01),
        ("3.16 entry", case, ["4.2", "5.0"], ["entry_forces"], [ramps, "ramp_starts"], None),
        ("3.16 exit", case, ["0.67"], ["time_of", "exit"], [ramps], 0.01),
        ("3.16 exit", case, ["0.46", "0.50"], ["exit_forces"], ["returns"], None),
    ]
    assert thesis()["rows"]["3.16 exit"] == "circle 0.75 m/s, CN 5, switching on"


class Own(Plans):
    """A memo in which cases have a plan as they are, and with no other value of an unstated parameter."""

    def outcome(self, case: Case, backend: str | None = None) -> Plan | InfeasiblePlanError:
        return super().outcome(case, backend) if case in BY_NAME.values() else InfeasiblePlanError("no")


PLANS = Own()


def test_deviations_are_ours_less_the_stated() -> None:
    judged = judge_all(PLANS, QUICK)[: len(thesis()["planned"])]
    for record in judged:
        for digits, value, deviation in zip(
            *(record[key].split(", ") for key in ("stated", "ours", "deviation")), strict=True
        ):
            if value != "–":
                ours, stated = float(value), float(digits.removeprefix("~"))
                # three digits are shown of ours, and two of the deviation
                assert float(deviation) == pytest.approx(ours - stated, rel=0.06, abs=6e-3 * abs(ours))
    assert sum("–" not in record["deviation"] for record in judged) > 10


def test_settings_without_a_plan_are_counted() -> None:
    records = sensitivity(PLANS, QUICK)
    for case in {record["case"]: BY_NAME[record["case"]] for record in records}.values():
        stated = thesis()["sensitivity"][case.path]
        varied = [variations(case, grid(name, QUICK)) for name in stated["grids"]]
        counts = [(len(one), sum(bool(label) for _, label in one)) for one in varied for _ in stated["quantities"]]
        found = [(record["plans"], record["without"]) for record in records if record["case"] == case.name]
        assert found == counts
        assert any(without for _, without in found)


def test_stated_numbers_are_met_to_what_the_thesis_rounds_and_reads_off() -> None:
    """Times to 0.02 s and forces to 20 %: the thesis reads them off samples and does not state its ramps."""
    names = {entry["case"] for entry in thesis()["motions"]}
    records = compare_motions([quick_results.motion_run(name, 4e-3) for name in sorted(names)])
    assert len(records) == len(thesis()["motions"])
    for record in records:
        tolerance = {"s": 0.02, "m": 0.005, "N·m": 0.1}[record["unit"]]
        np.testing.assert_allclose(record["computed"], record["stated"], atol=tolerance, err_msg=str(record))
    checked = 0
    for entry in thesis()["planned"]:
        if entry["row"].endswith(("entry", "exit")) and entry["measure"][0] in ("time_of", "entry_forces"):
            ours = read(PLANS.plan(BY_NAME[entry["case"]]), *entry["measure"])
            times = entry["unit"] == "s"
            np.testing.assert_allclose(
                ours, [*map(float, entry["stated"])], rtol=0.0 if times else 0.2, atol=0.02 * times, err_msg=str(entry)
            )
            checked += 1
    assert checked == 12
