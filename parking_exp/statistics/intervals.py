"""Numbers with confidence intervals."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Interval:
    """A number with its confidence interval.

    Attributes:
        value: e.g. the mean over seeds; None without data.
        low, high: None where the data allow for no interval, e.g. over one seed.
        n: number of seeds; for a difference, of the side with fewer seeds.
    """

    value: float | None
    low: float | None = None
    high: float | None = None
    n: int = 0
