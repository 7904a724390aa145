"""Random plans, and what it means for two plans to be the same. Shared by the tests of files and of pictures."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of
from scipy.spatial.transform import Rotation

from redundancy_pin.arrays import read_only
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.intersample_check import Findings, IntersamplePeaks
from redundancy_pin.planners.limits import LimitEvent, LimitReport, ResolvedLimits
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.robot_record import RobotRecord
from redundancy_pin.robot import CarrierLimits
from redundancy_pin.status import ResultStatus, SampleStatus
from redundancy_pin.trajectory.continuous_motion import Motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

ANY_FLOAT = st.floats(allow_nan=True, allow_infinity=True)
FINITE = st.floats(allow_nan=False, allow_infinity=False)
TEXT = st.text(max_size=6)
STORED_ARRAYS = st.one_of(
    arrays_of.arrays(dtype, arrays_of.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=3))
    for dtype in (np.float64, np.float32, np.int64, np.uint8, np.bool_, np.complex128)
)
KEYS = st.one_of(TEXT, st.sampled_from(["$tuple", "$array", "$float", "$mapping", "a.b", "a/b", ""]))
PLAIN = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), ANY_FLOAT, TEXT, STORED_ARRAYS),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.lists(inner, max_size=3).map(tuple),
        st.dictionaries(KEYS, inner, max_size=3),
        st.dictionaries(st.one_of(st.integers(), st.tuples(st.integers(), TEXT)), inner, max_size=2),
    ),
    max_leaves=8,
)
EVENTS = st.builds(
    LimitEvent, TEXT, st.sampled_from(["track", "speed", "acceleration", "force"]), *([FINITE] * 5), ANY_FLOAT
)
SIGNS = st.sampled_from([-1, 1])


@st.composite
def plans(draw: st.DrawFn) -> Plan:
    """Draw a plan of any size: two-sided samples, poses, NaN efforts, any plain parameters and diagnostics."""
    samples, n = draw(st.integers(1, 5)), draw(st.integers(1, 6))
    m, k = draw(st.integers(1, 4)), draw(st.integers(0, 3))
    steps = draw(st.lists(st.floats(1e-3, 10.0), min_size=samples, max_size=samples))
    t = np.cumsum(steps)
    two_sided = samples > 1 and draw(st.booleans())
    pose = n == 6 and draw(st.booleans())
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    x = _poses(rng, samples) if pose else rng.normal(size=(samples, n))
    xd, xdd = rng.normal(size=(samples, n)), rng.normal(size=(samples, n))
    if two_sided:
        t[1], x[1], xd[1] = t[0], x[0], xd[0]

    def floats(*shape: int) -> Any:
        return read_only(draw(arrays_of.arrays(np.float64, shape, elements=ANY_FLOAT)))

    def pieces(columns: int) -> PiecewisePolynomial:
        return PiecewisePolynomial(read_only(np.array([0.0, 1.0, 2.0])), floats(4, 2, columns))

    def codes(count: int) -> Any:
        return read_only(draw(arrays_of.arrays(np.intp, (samples,), elements=st.integers(0, count - 1))))

    tau = floats(samples, m)
    # a plan without finite efforts that claims anything else is refused
    statuses = list(ResultStatus) if np.isfinite(tau).all() else [ResultStatus.UNBOUNDED]
    phases = tuple(draw(st.lists(TEXT, min_size=1, max_size=3)))
    limits = st.builds(CarrierLimits, *([ANY_FLOAT.filter(lambda v: not np.isnan(v))] * 5))
    carriers = CarrierMotion(*(rng.normal(size=(samples, k)) for _ in range(3)))
    record = RobotRecord(
        name=draw(TEXT),
        source=draw(TEXT),
        arguments=draw(st.dictionaries(TEXT, st.one_of(FINITE, st.booleans(), TEXT), max_size=3)),
        gravity=(0.0, -0.0, -9.81),
        working_mode=tuple(draw(st.lists(SIGNS, max_size=3))),
        actuated=tuple(f"a{i}" for i in range(m)),
        carriers=tuple(f"c{i}" for i in range(k)),
        rotating=("a0",),
        carrier_limits=tuple(draw(limits) for _ in range(k)),
        bodies=tuple(tuple(row) for row in rng.normal(size=(3, 10)).tolist()),
        q_reference=tuple(rng.normal(size=4).tolist()),
    )
    return Plan(
        motion=PlatformMotion(t, x, xd, xdd),
        carriers=carriers,
        tau=tau,
        carrier_force=floats(samples, k),
        actuated_rate=floats(samples, m),
        sample_status=codes(len(SampleStatus)),
        residual=floats(samples),
        margin=floats(samples),
        condition=floats(samples),
        phase=codes(len(phases)),
        phases=phases,
        limits=LimitReport(
            tuple(draw(st.lists(EVENTS, max_size=2))),
            tuple(draw(st.lists(EVENTS, max_size=2))),
            ResolvedLimits(
                tuple(f"c{i}" for i in range(k)), floats(k, 2), *(floats(k) for _ in range(4)), floats(m), floats(m)
            ),
        ),
        status=draw(st.sampled_from(statuses)),
        planner=draw(TEXT),
        backend=draw(TEXT),
        robot=record,
        parameters=draw(st.dictionaries(KEYS, PLAIN, max_size=3)),
        findings=Findings(
            draw(st.booleans()),
            draw(TEXT),
            tuple(draw(st.lists(FINITE, max_size=2))),
            draw(st.none() | FINITE),
            tuple({"time": draw(FINITE), "x": [draw(FINITE)]} for _ in range(draw(st.integers(0, 1)))),
        ),
        diagnostics=draw(st.dictionaries(KEYS, PLAIN, max_size=3)),
        functions=PlanFunctions(
            Motion(pieces((16 if pose else n) + 2 * n), 0.0, 2.0, 2.0, floats(1), floats(2), True),
            pieces(k or 1),
            prescribed=tuple(pieces(m) for _ in range(draw(st.integers(0, 2)))),
            preferred=draw(st.sampled_from([None, pieces(m)])),
        ),
        between=IntersamplePeaks(floats(m), floats(m), floats(k), draw(FINITE)),
    )


def difference(ours: Any, theirs: Any, name: str = "plan") -> str:
    """Say where two values differ first, bit for bit and type for type (mappings: whatever kind); empty if nowhere."""
    if isinstance(ours, Mapping):
        if not isinstance(theirs, Mapping) or list(ours) != list(theirs):
            return f"{name}: keys {list(ours)} and {theirs!r:.80}"
        return _first(difference(ours[key], theirs[key], f"{name}[{key!r}]") for key in ours)
    if type(ours) is not type(theirs):
        return f"{name}: {type(ours).__name__} and {type(theirs).__name__}"
    if is_dataclass(ours):
        return _first(
            difference(getattr(ours, field.name), getattr(theirs, field.name), f"{name}.{field.name}")
            for field in fields(ours)
            if field.compare  # but for the folder a plan was read from
        )
    if isinstance(ours, np.ndarray):
        same = ours.dtype == theirs.dtype and ours.shape == theirs.shape and ours.tobytes() == theirs.tobytes()
        return "" if same else f"{name}: arrays differ"
    if isinstance(ours, (list, tuple)):
        if len(ours) != len(theirs):
            return f"{name}: lengths {len(ours)} and {len(theirs)}"
        return _first(difference(a, b, f"{name}[{i}]") for i, (a, b) in enumerate(zip(ours, theirs, strict=True)))
    if isinstance(ours, float):
        # every NaN is one NaN outside arrays
        same = struct.pack("d", ours) == struct.pack("d", theirs) or (ours != ours and theirs != theirs)
        return "" if same else f"{name}: {ours!r} and {theirs!r}"
    return "" if ours == theirs else f"{name}: {ours!r} and {theirs!r}"


def _first(texts: Any) -> str:
    return next((text for text in texts if text), "")


def _poses(rng: np.random.Generator, samples: int) -> np.ndarray:
    pose = np.tile(np.eye(4), (samples, 1, 1))
    pose[:, :3, :3] = Rotation.from_rotvec(rng.normal(size=(samples, 3))).as_matrix()
    pose[:, :3, 3] = rng.normal(size=(samples, 3))
    return pose
