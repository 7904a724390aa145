"""Problems and settings of a sweep that make no sense are refused before anything is computed."""

from __future__ import annotations

from typing import Any

import pytest
from small_maps import corner, crossing

from redundancy_pin.errors import InputError
from redundancy_pin.studies.feasibility import WHOLE, Axis, feasibility_map
from redundancy_pin.studies.verdicts import Key

BAD: dict[str, tuple[Any, str]] = {
    "misspelt axis": (lambda: corner(x=Axis("sped", (1, 2))), "Did you mean 'speed'"),
    "argument of another robot": (lambda: corner(x=Axis("end_effector_mass", (1, 2))), "no parameter"),
    "argument that is no number": (lambda: corner(x=Axis("carriers", (0, 1))), "no parameter"),
    "key of another trajectory": (lambda: corner(x=Axis("side", (0.1, 0.2))), "no parameter"),
    "same axis twice": (lambda: corner(x=Axis("stroke", (1, 2))), "Both axes are stroke"),
    "axis that is fixed": (lambda: corner(limits={"stroke": 1.0}), "has the fixed value 1.0"),
    "axis fixed in the trajectory": (lambda: corner(options={"speed": 1.0}), "has the fixed value"),
    "axis of one value": (lambda: Axis("speed", (1.0,)), "at least two"),
    "axis that does not increase": (lambda: Axis("speed", (1.0, 0.5)), "do not increase"),
    "axis with a double": (lambda: Axis("speed", (1.0, 1.0)), "do not increase"),
    "axis of infinity": (lambda: Axis("speed", (1.0, float("inf"))), "finite"),
    "axis of words": (lambda: Axis("speed", ("slow", "fast")), "not numbers"),  # type: ignore[arg-type]
    "logarithm of zero": (lambda: Axis("speed", (0.0, 1.0), "log"), "no logarithm"),
    "unknown scale": (lambda: Axis("speed", (0.0, 1.0), "cubic"), "scale"),  # type: ignore[arg-type]
    "negative speed": (lambda: corner(x=Axis("speed", (-1.0, 1.0))), "positive"),
    "no stroke": (lambda: corner(y=Axis("stroke", (0.0, 1.0))), "positive"),
    "negative limit": (lambda: corner(limits={"max_effort": -1.0}), "positive"),
    "limit of infinity": (lambda: corner(limits={"max_effort": float("inf")}), "Leave out"),
    "unknown limit": (lambda: corner(limits={"max_torque": 1.0}), "no limit"),
    "unknown planner": (lambda: corner(planners=("step-wise",)), "Did you mean 'stepwise'"),
    "no planner": (lambda: corner(planners=()), "at least one"),
    "planner twice": (lambda: corner(planners=(WHOLE, WHOLE)), "once"),
    "unknown trajectory": (lambda: corner(trajectory="coner"), "Did you mean 'corner'"),
    "unknown backend": (lambda: corner(backend="virtual_work"), "Did you mean 'virtual-work'"),
    "unknown option": (lambda: corner(options={"radios": 1.0}), "Did you mean 'radius'"),
    "unknown parameter": (
        lambda: corner(parameters={WHOLE: {"objektive": "peak"}}),
        "no parameter of whole-trajectory",
    ),
    "limit as a parameter": (lambda: corner(parameters={WHOLE: {"effort": 1.0}}), "Limits are those of the map"),
    "unknown robot argument": (lambda: corner(settings={"carrier_mas": 1.0}), "carrier_mass"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_problems_are_refused(case: str, computed: list[Key]) -> None:
    make, says = BAD[case]
    with pytest.raises(InputError) as caught:
        feasibility_map(make(), jobs=1)
    assert says in str(caught.value)
    assert computed == []


@pytest.mark.parametrize("given", [{"jobs": 0}, {"refine": -1}, {"refine": 0.5}, {"along": "z"}])
def test_bad_settings_of_the_sweep_are_refused(given: dict[str, Any], computed: list[Key]) -> None:
    with pytest.raises(InputError):
        feasibility_map(crossing(), **given)
    assert computed == []
