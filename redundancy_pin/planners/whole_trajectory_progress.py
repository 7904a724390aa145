"""Progress of the solver on long plans."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from redundancy_pin.planners.whole_trajectory_program import casadi

Say = Callable[[str], None]
"""Takes one line of text."""

LONG = 1000
"""Nodes from which the iterations are reported; below, a plan takes less than a second or two."""

PERIOD = 0.5
"""Time between two lines at least, s."""


def watcher(variables: int, rows: int, say: Say) -> Any:
    """Return what the solver calls at every iteration: it says the iteration and the scaled objective now and then.

    Args:
        variables: number of variables of the programme.
        rows: number of its rows.
        say: called with one line of text, at most twice a second. What it raises stops the solver and is kept in
            the attribute ``error``.
    """
    library = casadi()
    vectors = {"x": variables, "f": 1, "g": rows, "lam_x": variables, "lam_g": rows, "lam_p": 0}

    base: Any = library.Callback

    class Watcher(base):  # type: ignore[misc] # the base class exists only once the library is loaded
        def __init__(self) -> None:
            library.Callback.__init__(self)
            self.count, self.began, self.last = 0, time.perf_counter(), -PERIOD
            self.error: BaseException | None = None
            self.construct("watcher", {})

        def get_n_in(self) -> int:
            return int(library.nlpsol_n_out())

        def get_n_out(self) -> int:
            return 1

        def get_name_in(self, i: int) -> str:
            return str(library.nlpsol_out(i))

        def get_name_out(self, i: int) -> str:
            return "stop"

        def get_sparsity_in(self, i: int) -> Any:
            return library.Sparsity.dense(vectors[library.nlpsol_out(i)], 1)

        def eval(self, arguments: Any) -> list[int]:
            now = time.perf_counter() - self.began
            if now - self.last >= PERIOD:
                self.last = now
                try:
                    say(f"iteration {self.count}, {now:.0f} s: scaled objective {float(arguments[1]):.6g}")
                except BaseException as error:  # an interruption too would be lost in the library
                    self.error = error
                    return [1]
            self.count += 1
            return [0]

    return Watcher()
