"""Limits met to rounding are met: a path that touches the border of the workspace from 1e-12 of a leg inside."""

from __future__ import annotations

import numpy as np
import pytest

import redundancy_pin as rp
from redundancy_pin.singularities.classify import SingularityKind
from redundancy_pin.singularities.crossings import find_crossings


@pytest.mark.parametrize(("leg", "hinge", "angle"), [(1, 0.0, 50.0), (2, 0.5, 130.0)])
@pytest.mark.parametrize("inside", [1e-12, 1e-13, 0.0])
def test_a_touch_from_rounding_inside_is_no_way_out(leg: int, hinge: float, angle: float, inside: float) -> None:
    """Quintics through rounded samples leave it by 1e-12 m next to the touch, a tenth of the closure tolerance."""
    t, step = np.linspace(0.0, 1.0, 201), 1e-5

    def tip(time: np.ndarray) -> np.ndarray:
        turned, reach = np.deg2rad(angle) + 0.6 * (time - 0.503), 1.0 - inside - 0.4 * (time - 0.503) ** 2
        return np.column_stack([hinge + reach * np.cos(turned), reach * np.sin(turned)])

    before, here, after = tip(t - step), tip(t), tip(t + step)
    rates = (after - before) / (2.0 * step), (after - 2.0 * here + before) / step**2
    met = find_crossings("five_bar", rp.PlatformMotion(t, here, *rates, check_rates=False))
    assert met or inside < 1e-12
    for crossing in met:
        assert (crossing.kind, crossing.leg) == (SingularityKind.TYPE_I, leg)
        assert crossing.t == pytest.approx(0.503, abs=1e-5)
