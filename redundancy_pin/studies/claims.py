"""Claims with a verdict that is computed and a sentence that is written once, in ``claims.yaml``."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import jinja2
import yaml

from redundancy_pin.studies.table import Record, span, text

FILTERS = {
    "n": text,
    "n1": lambda value: text(value, ".1g"),
    "n2": lambda value: text(value, ".2g"),
    "r": lambda values: span(values, ".2g"),
}
"""Of templates: a number (in three, one, two digits), and a range of factors."""


def environment(loader: jinja2.BaseLoader | None = None) -> jinja2.Environment:
    """Return what renders Markdown templates: a name that does not exist is an error."""
    made = jinja2.Environment(
        loader=loader,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.filters.update(FILTERS)
    return made


@functools.cache
def claims() -> Mapping[str, Mapping[str, str]]:
    """Return the claims of the data file by name: ``claim`` and the template ``here``."""
    data: Mapping[str, Any] = yaml.safe_load(files(__package__).joinpath("claims.yaml").read_text(encoding="utf-8"))
    return data


def verdict(good: int, total: int) -> str:
    """Return what may be said of a claim that holds in some of all cases."""
    if good == total:
        return "stands"
    return "stands with conditions" if good else "does not stand"


def claim(name: str, stands: str, **values: Any) -> Record:
    """Return what becomes of a claim.

    Args:
        name: in the data file.
        stands: its verdict.
        **values: the numbers that its sentence shows.
    """
    claimed, here = (
        " ".join(environment().from_string(claims()[name][part]).render(values).split()) for part in ("claim", "here")
    )
    return {"name": name, "claim": claimed, "stands": stands, "here": here, "numbers": values}
