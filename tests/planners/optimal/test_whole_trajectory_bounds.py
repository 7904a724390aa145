"""Bounds of objectives: what weights find is found by bounds, and what would suffice is the least there is."""

from __future__ import annotations

from typing import Any

import pytest

import redundancy_pin as rp
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.studies.case import in_groups, load
from redundancy_pin.trajectory import reference

SETTINGS = {"acceleration": 20.0, "speed": 5.0, "dt": 0.02, "refinements": 0}


def planned(**options: Any) -> Plan:
    return rp.plan_whole_trajectory(
        rp.VirtualWork(load("3rrr")),
        reference.corner(radius=0.025),
        **in_groups(rp.plan_whole_trajectory, dict(**SETTINGS, **options)),
    )


def values(plan: Plan) -> dict[str, float]:
    return plan.diagnostics["objective"]  # type: ignore[return-value]


@pytest.mark.parametrize(("x", "y", "weight"), [("base_force", "effort", 0.02), ("carrier_force", "effort", 0.05)])
def test_a_bound_finds_what_a_weight_finds(x: str, y: str, weight: float) -> None:
    """Of a convex front: the least y under the x of a weighted sum is the y of that sum."""
    weighted = values(planned(objective={y: 1.0, x: weight}))
    bounded = planned(objective=y, at_most={x: weighted[x]})
    assert values(bounded)[y] == pytest.approx(weighted[y], rel=1e-4)
    assert values(bounded)[x] <= weighted[x] * (1.0 + 1e-8)
    assert bounded.parameters["at_most"] == {x: weighted[x]}
    # the bound is what holds it back
    assert values(planned(objective=y))[y] < 0.99 * weighted[y]


@pytest.mark.long
def test_a_bound_that_cannot_be_kept_says_the_least_that_can() -> None:
    least = values(planned(objective="carrier_force"))["carrier_force"]
    with pytest.raises(InfeasiblePlanError, match=r"carrier_force at most, from 0.5 to") as caught:
        planned(objective="effort", at_most={"carrier_force": 0.5})
    (event,) = (one for one in caught.value.details["relaxations"] if one["constraint"] == "at_most")
    assert event["limit"] == pytest.approx(least, rel=1e-3)
    assert event["objective"] == "carrier_force"


@pytest.mark.parametrize("at_most", [{"efort": 1.0}, {"effort": 0.0}, {"effort": float("nan")}, "effort", [1]])
def test_bounds_that_are_none(at_most: Any) -> None:
    with pytest.raises(InputError, match=r"at_most|objectives to bounds"):
        planned(at_most=at_most)
