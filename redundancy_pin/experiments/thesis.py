"""The experiments of the thesis that need no planner: every motion with carriers parked, and without carriers."""

from __future__ import annotations

from redundancy_pin.experiments.experiment import Carriers, Experiment

_SINGULAR_SOURCE = "Parsa 2014, section 3.2"
_CORNER_SOURCE = "Parsa 2014, section 4.2"


def _circle(speed: float, thresholds: tuple[float, ...]) -> Experiment:
    name = f"circle-{speed:g}"
    return Experiment(
        name=f"{name}-parked",
        motion_name=name,
        title=f"2-RPR, circle at {speed:g} m/s, carriers parked",
        source=_SINGULAR_SOURCE,
        robot="2rpr",
        carriers="parked",
        path="circle",
        path_options={"speed": speed},
        working_mode=(1, 1),
        thresholds=thresholds,
    )


def _line(speed: float, thresholds: tuple[float, ...]) -> Experiment:
    name = f"line-{speed:g}"
    return Experiment(
        name=f"{name}-parked",
        motion_name=name,
        title=f"2-RPR, line at {speed:g} m/s, carriers parked",
        source=_SINGULAR_SOURCE,
        robot="2rpr",
        carriers="parked",
        path="line",
        path_options={"speed": speed},
        working_mode=(1, 1),
        thresholds=thresholds,
    )


def _corner(radius: float, carriers: Carriers) -> Experiment:
    name = f"corner-r{radius:g}"
    what = "carriers parked" if carriers == "parked" else "no carriers"
    return Experiment(
        name=f"{name}-{_suffix(carriers)}",
        motion_name=name,
        title=f"3-RRR, corner of radius {radius:g} m, {what}",
        source=_CORNER_SOURCE,
        robot="3rrr",
        carriers=carriers,
        path="corner",
        path_options={"radius": radius},
        working_mode=(1, 1, 1),
    )


def _square(carriers: Carriers) -> Experiment:
    what = "carriers parked" if carriers == "parked" else "no carriers"
    return Experiment(
        name=f"square-{_suffix(carriers)}",
        motion_name="square",
        title=f"3-RRR, square, {what}",
        source=_CORNER_SOURCE,
        robot="3rrr",
        carriers=carriers,
        path="square",
        working_mode=(1, 1, 1),
    )


def _suffix(carriers: Carriers) -> str:
    return "parked" if carriers == "parked" else "baseline"


# The 2-RPR of the thesis is massless but for its carriers: without them every force is zero, and there is no baseline.
EXPERIMENTS: tuple[Experiment, ...] = (
    _circle(0.5, (5.0, 10.0, 20.0)),
    _circle(0.75, (5.0,)),
    _line(0.1, (4.0,)),
    _line(0.2, (4.0, 15.0)),
    _corner(0.025, "none"),
    _corner(0.025, "parked"),
    _corner(0.013, "none"),
    _corner(0.013, "parked"),
    _square("none"),
    _square("parked"),
)
"""What ``reproduce`` runs, in this order."""
