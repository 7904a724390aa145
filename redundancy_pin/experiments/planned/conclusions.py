"""What becomes of the thesis's conclusions, in sentences made from the numbers of the run: they change with them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from redundancy_pin.experiments.planned.cases import mode_text
from redundancy_pin.experiments.planned.crossings import CrossingRow, Infeasible
from redundancy_pin.experiments.planned.fair import MOVING, NONE, PARKED, FairRow
from redundancy_pin.experiments.planned.mode_table import ClaimRow


@dataclass(frozen=True)
class Conclusion:
    """A conclusion of the thesis and what becomes of it.

    Attributes:
        thesis: the conclusion, in our words, with its place.
        here: what this run says.
        stands: "stands", "stands with conditions" or "does not stand".
    """

    thesis: str
    here: str
    stands: str

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON."""
        return dict(vars(self))


def conclusions(
    fair: Sequence[FairRow],
    crossings: Sequence[CrossingRow],
    heavy: Infeasible | None,
    claims: Sequence[ClaimRow],
) -> tuple[Conclusion, ...]:
    """Return every conclusion with what becomes of it."""
    return (
        _crossing(crossings, heavy),
        _limits(crossings),
        _exit_forces(crossings),
        _corner(fair, "corner-r0.025", "Moving carriers reduce the base torques at a corner (section 5.1.2)."),
        _corner(fair, "corner-r0.013", "At a sharper corner the optimised torques can exceed the baseline's (5.1.2)."),
        _square(fair),
        _shared(fair),
        _agreement(claims),
    )


def verdict(good: int, total: int) -> str:
    """Return what may be said of a conclusion that holds in some of all cases."""
    if good == total:
        return "stands"
    return "stands with conditions" if good else "does not stand"


def _crossing(crossings: Sequence[CrossingRow], heavy: Infeasible | None) -> Conclusion:
    crossed = len(crossings)
    inside = [row.case for row in crossings if row.status == "within_limits"]
    here = f"All {crossed} crossings exist as motions of the massless machine; {len(inside)} keep the carriers' limits"
    here += f" ({', '.join(inside)})." if inside else "."
    if heavy is not None:
        force = heavy.details.get("amount")
        size = f" of {force:.3g} N" if isinstance(force, float) else ""
        here += (
            f" With a massive end-effector ({heavy.what.rpartition(', ')[2]}) none exists: at the singular pose an "
            f"inertial force{size} is left that neither set of actuators can carry."
        )
    else:
        here += " So does that with a massive end-effector."
    return Conclusion(
        "Two actuated masses carry a 2-RPR through type II singularities with the main actuators off (5.1.1).",
        here,
        verdict(len(inside) + (heavy is None), crossed + 1),
    )


def _limits(crossings: Sequence[CrossingRow]) -> Conclusion:
    out = [row for row in crossings if row.beyond_track_at_exit > 0.0]
    broken = [row for row in crossings if row.status == "violates_limits"]
    never = [row for row in crossings if row.no_shortest]
    parts = []
    for row in out:
        parts.append(f"{row.case} is {row.beyond_track_at_exit:.3f} m beyond its track already when switched on")
    here = f"{len(broken)} of {len(crossings)} plans break a limit" + (": " + "; ".join(parts) + "." if parts else ".")
    cured = [f"{row.case} ({row.shortest:.3f} s)" for row in broken if not row.no_shortest]
    if cured:
        here += f" Another duration of the return cures {', '.join(cured)}."
    if never:
        here += f" For {', '.join(row.case for row in never)} no duration of the return keeps the limits."
    return Conclusion(
        "Limits of the carriers need not be considered in the crossing, as the motions are small (section 3.4).",
        here,
        verdict(len(crossings) - len(broken), len(crossings)),
    )


def _exit_forces(crossings: Sequence[CrossingRow]) -> Conclusion:
    jumps = max(max(row.jump) for row in crossings)
    steps = max(max(row.jump_of_differences) for row in crossings)
    artefact = jumps < 1e-3 * steps
    if artefact:
        here = (
            f"Solved exactly, forces are continuous on switching on (largest jump {jumps:.1g} N); by backward "
            f"differences with a step of {1e3 * crossings[0].step:g} ms they jump by up to {steps:.2g} N. The jumps "
            "come from the discretisation, not from the inverse of the Jacobian."
        )
        same_motion = [max(row.jump_of_differences) for row in crossings if row.case.startswith("circle-0.5-")]
        listed = ", ".join(f"{value:.2g}" for value in same_motion)
        grows = len(same_motion) > 1 and sorted(same_motion) == same_motion
        here += (
            f" With that step they {'grow' if grows else 'do not grow'} with the threshold: {listed} N on the circle."
        )
    else:
        here = f"Also solved exactly, forces jump by up to {jumps:.2g} N (backward differences: {steps:.2g} N)."
    return Conclusion(
        "A larger threshold leads to larger forces when the actuators are switched on again (section 5.1.1).",
        here,
        "does not stand" if artefact else "stands",
    )


def _groups(fair: Sequence[FairRow], motion: str) -> list[dict[str, FairRow]]:
    groups: dict[tuple[int, ...], dict[str, FairRow]] = {}
    for row in fair:
        if row.motion == motion:
            groups.setdefault(row.mode, {})[row.what] = row
    return list(groups.values())


def _count(groups: Sequence[dict[str, FairRow]], test: Callable[[dict[str, FairRow]], bool]) -> int:
    return sum(test(group) for group in groups)


def _times(values: Sequence[float]) -> str:
    low, high = min(values), max(values)
    return f"{low:.2g}" if f"{low:.2g}" == f"{high:.2g}" else f"{low:.2g} to {high:.2g}"


def _corner(fair: Sequence[FairRow], motion: str, thesis: str) -> Conclusion:
    groups = _groups(fair, motion)
    key = f"{MOVING}, λ = 0"
    total = len(groups)
    below = _count(groups, lambda group: group[key].peak < group[NONE].peak)
    below_parked = _count(groups, lambda group: group[key].peak < group[PARKED].peak)
    parked = _times([group[PARKED].peak / group[NONE].peak for group in groups])
    moving = _times([group[key].peak / group[NONE].peak for group in groups])
    here = (
        f"Against the machine without carriers the peak is lower in {below} of {total} working modes ({moving} times), "
        f"against the same machine with parked carriers in {below_parked} of {total}; the parked carriers alone make "
        f"it {parked} times as large."
    )
    raised = [what for what in groups[0] if what.startswith(key + ",")]
    for what in raised:
        cured = _count(groups, lambda group, what=what: group[what].peak < group[NONE].peak)  # type: ignore[misc]
        here += f" With {what.rpartition(', ')[2]} it is lower in {cured} of {total}."
    exceeds = "exceed" in thesis
    return Conclusion(thesis, here, verdict(total - below if exceeds else below, total))


def _square(fair: Sequence[FairRow]) -> Conclusion:
    groups = _groups(fair, "square")
    keys = [what for what in groups[0] if what.startswith(MOVING)]
    pairs = [(group[key], group[NONE]) for group in groups for key in keys]
    better = sum(moving.peak < none.peak for moving, none in pairs)
    broken = sum(moving.status != "within_limits" for moving, _ in pairs)
    here = (
        f"Over the whole square, returns included, the peak is {_times([a.peak / b.peak for a, b in pairs])} times and "
        f"the rms {_times([a.rms / b.rms for a, b in pairs])} times that of the machine without carriers; the peak is "
        f"lower in {better} of {len(pairs)} plans, and {broken} of them break a limit of the carriers on a return."
    )
    if not better:
        here += " What is gained in the corners is lost, many times over, in bringing the carriers back."
    return Conclusion(
        "Moving carriers lower the largest base torques on the square (section 4.4).",
        here,
        verdict(better, len(pairs)),
    )


def _shared(fair: Sequence[FairRow]) -> Conclusion:
    pairs = []
    for motion in ("corner-r0.025", "corner-r0.013"):
        pairs += [(group[f"{MOVING}, λ = 0"], group[NONE]) for group in _groups(fair, motion)]
    relieved = sum(moving.peak < none.peak and moving.main_energy < none.main_energy for moving, none in pairs)
    total = [moving.energy / none.energy for moving, none in pairs]
    main = _times([moving.main_energy / none.main_energy for moving, none in pairs])
    here = (
        f"At both corners with λ = 0 the base actuators move {main} times the energy they need without carriers, and "
        f"are relieved in peak and energy in {relieved} of {len(pairs)} plans. With the carriers' own actuators, which "
        f"need {_times([moving.carrier_force for moving, _ in pairs])} N, it is {_times(total)} times the energy"
    )
    here += "." if min(total) < 1.0 else ": the effort is not shared but multiplied."
    return Conclusion(
        "The effort is shared: tasks beyond the base actuators become feasible without changing them (5.1.2).",
        here,
        verdict(relieved, len(pairs)),
    )


def _agreement(claims: Sequence[ClaimRow]) -> Conclusion:
    modes = list(claims[0].outcomes)
    counts = [sum(row.outcomes[mode][0] for row in claims) for mode in modes]
    best, total = max(counts), len(claims)
    which = ", ".join(mode_text(mode) for mode, count in zip(modes, counts, strict=True) if count == best)
    several = sum(count == best for count in counts) > 1
    who = f"The best working modes, {which}, reproduce" if several else f"The best working mode, {which}, reproduces"
    here = f"{who} {best} of the {total} statements made in words; "
    here += "one working mode gives them all." if best == total else "no single working mode gives them all."
    return Conclusion(
        "The figures of chapter 4 show one machine in one working mode (not stated).",
        here,
        verdict(sum(count == total for count in counts), len(counts)),
    )
