"""The chapter on replays as sections of the report."""

from __future__ import annotations

import math

from redundancy_pin.experiments.document import Block, Heading, Paragraph, Picture, table
from redundancy_pin.experiments.replay.pictures import FIGURES
from redundancy_pin.experiments.replay.study import Replays
from redundancy_pin.simulation.replay import AWAY, SAMPLING, SPEED, Replay

SET_UP = (
    "Plans are fed to the forward dynamics of their own robot. Open loop the machine starts exactly where the plan "
    "does and gets the efforts of the continuous motion that the plan stands for; 'samples' are the efforts at the "
    "samples of the plan alone, linear in between, which shows what its discretisation costs. Computed torque and LQR "
    f"are digital ({1.0 / SAMPLING.period:g} Hz, {1e3 * SAMPLING.delay:g} ms of delay) and start {1e3 * AWAY:g} mm "
    f"and {1e3 * SPEED:g} mm/s off, so their largest error is at least that. Errors are distances of the platform "
    "from the planned motion, rotations times the characteristic length."
)
MASSLESS = (
    "The 2-RPR of the thesis has no mass but its carriers: with them at s = 0, and at every type II pose, forces do "
    "not determine its motion, so its plans cannot be replayed as forces. With carriers moved along their plan they "
    "can, up to the type II pose. The crossings are therefore replayed on the machine with masses, in plan and replay "
    "alike."
)


def chapter(replays: Replays) -> list[Block]:
    """Return the chapter."""
    rows = [
        (
            row.plan,
            row.drive,
            row.status,
            _size(row.largest),
            _size(row.rms),
            _size(row.last),
            _size(row.carrier_error),
            _size(row.carrier_lag),
            _size(row.off_track),
            _size(row.effort),
            _size(row.carrier_force),
        )
        for row in replays.rows
    ]
    return [
        Heading("Replay: what the machine does with the plans"),
        Paragraph(SET_UP),
        Paragraph(MASSLESS),
        table(
            (
                "plan",
                "drive",
                "status",
                "largest error [m]",
                "rms [m]",
                "at the end [m]",
                "carriers [m]",
                "carrier lag of the plan [m]",
                "off the track [m]",
                "largest |τ| [N or N·m]",
                "largest carrier force [N]",
            ),
            rows,
            "Carriers: largest distance from the planned motion. Carrier lag: of that motion from the samples of the "
            "plan, which is what backward differences leave of stepwise plans. Off the track: largest distance of a "
            "carrier beyond its end, where replays go on though a machine would have hit its stop.",
        ),
        *(Paragraph(f"{row.plan}, {row.drive}: {row.reason}") for row in replays.rows if _said(row)),
        *(Paragraph(f"No plan for {name}: {why}") for name, why in replays.missing.items()),
        *(Picture(f"{figure.stem}.png", figure.caption) for figure in FIGURES if replays.of(figure.case)),
    ]


def _said(row: Replay) -> bool:
    return bool(row.reason)


def _size(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.2g}"
