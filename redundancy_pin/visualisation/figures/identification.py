"""The report of an identification: one HTML page, its pictures embedded, without scripts or network."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import jinja2
import numpy as np
from scipy.signal import welch

from redundancy_pin.io.files import write_text
from redundancy_pin.robot.scales import is_revolute, turning_coordinates
from redundancy_pin.visualisation.figures.style import brief, figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Fit: TypeAlias = Any
"""``identification.Fit``; figures import no backend, and a fit has one."""

_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{{ title }}</title>
<style>body{font:15px sans-serif;max-width:60em;margin:2em auto;padding:0 1em}td,th{padding:.2em .8em;text-align:right}
td:first-child,th:first-child{text-align:left}tr:nth-child(even){background:#f4f4f4}img{max-width:100%}</style></head>
<body><h1>{{ title }}</h1>
<p>Status {{ fit.status.value }}; {{ fit.t|length }} samples; intervals are 95 %.</p>
{% if fit.problems %}<h2>What is doubtful</h2>
<ul>{% for one in fit.problems %}<li>{{ one }}</li>{% endfor %}</ul>{% endif %}
<h2>Parameters</h2>
<table><tr><th>base parameter</th><th>declared</th><th>value</th><th>±</th><th>unit</th></tr>
{% for name, before, value, half, unit in rows %}<tr><td>{{ name }}</td><td>{{ before }}</td><td>{{ value }}</td>
<td>{{ half }}</td><td>{{ unit }}</td></tr>
{% endfor %}</table>
{% if fit.base.unseen %}<details><summary>{{ fit.base.unseen|length }} parameters are not shown by the motion.</summary>
<p>{{ fit.base.unseen|join(", ") }}</p></details>{% endif %}
{% for name, picture in pictures.items() %}<h2>{{ name }}</h2>
<img alt="{{ name }}" src="data:image/png;base64,{{ picture }}">
{% endfor %}</body></html>
"""


def write_report(fit: Fit, path: str | Path) -> None:
    """Write the report of a fit as an HTML page.

    It has the table of the parameters, their values over their scales with 95 % bars, measured and predicted forces
    over time, and the spectrum of the whitened residuals, which is flat at 1 where the model holds.

    Raises:
        OutputError: the file cannot be written.

    Example:
        >>> write_report(fit, "fit.html")
    """
    half = 0.5 * np.diff(fit.intervals, axis=1)[:, 0]
    declared = fit.base.combination @ fit.base.standard
    numbers = zip(fit.base.names, declared, fit.values, half, fit.base.units, strict=True)
    rows = [(name, f"{a:.5g}", f"{b:.5g}", f"{c:.2g}", unit) for name, a, b, c, unit in numbers]
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    title = f"Identification of {fit.before.name}"
    page = environment.from_string(_PAGE).render(fit=fit, title=title, rows=rows, pictures=_pictures(fit))
    write_text(path, page)


def _pictures(fit: Fit) -> dict[str, str]:
    """Return pictures of parameters, forces and residuals, base64, by their headings."""
    robot, base, scales = fit.before, fit.base, fit.base.sizes[fit.base.independent]
    names = [*(robot.platform.axes if robot.platform else robot.independent_joints), *robot.carriers]
    turning = [*turning_coordinates(robot), *(is_revolute(robot, joint) for joint in robot.carriers)]
    places, half = np.arange(len(base))[::-1], 0.5 * np.diff(fit.intervals, axis=1)[:, 0]
    with figure(9.0, 1.2 + 0.25 * len(base)) as bars:
        axes = bars.subplots()
        axes.errorbar(fit.values / scales, places, xerr=half / scales, fmt="o", capsize=3, label="estimate, 95 %")
        axes.plot((base.combination @ base.standard) / scales, places, "x", color="0.4", label="declared")
        axes.set_yticks(places, [brief(name.split(" + ")[0].split(" - ")[0]) for name in base.names])
        axes.set(xlabel="base parameter, named by its first term, over the robot's scale [1]", ylim=(-0.7, len(base)))
        axes.legend()
    columns = list(zip(names, turning, fit.measured.T, fit.predicted.T, fit.residual.T, strict=False))
    with figure(9.0, 2.0 * len(columns) + 0.6) as forces:
        panels = forces.subplots(len(columns), squeeze=False, sharex=True)[:, 0]
        for panel, (name, turns, measured, predicted, _) in zip(panels, columns, strict=True):
            panel.plot(fit.t, measured, ".", ms=2, color="0.6", label="measured")
            panel.plot(fit.t, predicted, lw=1.0, label="predicted")
            panel.set_ylabel(f"{brief(name)} [{'N·m' if turns else 'N'}]")
        panels[0].legend(loc="upper right")
        panels[-1].set_xlabel("t [s]")
    with figure(9.0, 3.2) as spectra:
        axes, rate = spectra.subplots(), 1.0 / float(np.median(np.diff(fit.t)))
        for name, *_, residual in columns:
            frequency, density = welch(residual, fs=rate, nperseg=min(128, len(residual)), detrend=False)
            axes.loglog(frequency[1:], density[1:] * 0.5 * rate, lw=0.8, label=brief(name))
        axes.axhline(1.0, color="0.4", ls="--", label="white noise")
        axes.set(xlabel="frequency [Hz]", ylabel="density over white noise [1]")
        axes.legend()
    drawn = {"Parameters over their scales": bars, "Measured and predicted": forces, "Residual spectrum": spectra}
    return {name: _png(page) for name, page in drawn.items()}


def _png(page: Figure) -> str:
    buffer = io.BytesIO()
    page.savefig(buffer, format="png", dpi=110)
    return base64.b64encode(buffer.getvalue()).decode("ascii")
