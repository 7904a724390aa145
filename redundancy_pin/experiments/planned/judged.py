"""One row of the table that holds the thesis against this run."""

from __future__ import annotations

from dataclasses import dataclass

from redundancy_pin.experiments.planned.verdict import Verdict


@dataclass(frozen=True)
class Judged:
    """A statement of the thesis, ours beside it, and the verdict.

    Attributes:
        row: which of ``ROWS`` it belongs to.
        source: figure or section of Parsa 2014.
        condition: under which it is stated.
        quantity: what is stated, with its unit.
        stated: as printed.
        ours: from this run.
        deviation: ours less stated; empty where no number is stated.
        covered: range of ours over what is unstated, and over what; empty where there is none.
        verdict: by the rule in ``verdict``.
        reason: why it differs, or with which unstated value or in which working modes it holds; may be empty.
        as_run: whether the run itself, nothing varied, reproduces it.
    """

    row: str
    source: str
    condition: str
    quantity: str
    stated: str
    ours: str
    deviation: str
    covered: str
    verdict: Verdict
    reason: str = ""
    as_run: bool = False

    @property
    def said(self) -> str:
        """Verdict and reason: ``"differs: …"``."""
        return f"{self.verdict}: {self.reason}" if self.reason else self.verdict

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON."""
        return dict(vars(self))


ROWS: dict[str, str] = {
    "3.11 entry": "circle 0.5 m/s, CN 5, switching off",
    "3.11 exit": "circle 0.5 m/s, CN 5, switching on",
    "3.13 entry": "circle 0.5 m/s, CN 10, switching off",
    "3.13 exit": "circle 0.5 m/s, CN 10, switching on",
    "3.14 entry": "circle 0.5 m/s, CN 20, switching off",
    "3.14 exit": "circle 0.5 m/s, CN 20, switching on",
    "3.16 entry": "circle 0.75 m/s, CN 5, switching off",
    "3.16 exit": "circle 0.75 m/s, CN 5, switching on",
    "3.18-3.20": "line 0.1 m/s",
    "3.21-3.22": "line 0.2 m/s, CN 4 and 15",
    "4.8-4.9": "corner r 0.025 m, λ 0",
    "4.10-4.11": "corner r 0.013 m, λ 0",
    "4.12-4.14": "corner r 0.025 m, λ 0.5",
    "4.15-4.16": "square, λ 0.5",
    "4.17-4.18": "square, λ 0",
}
"""Result figures about which the thesis states something that can be held against a run."""
