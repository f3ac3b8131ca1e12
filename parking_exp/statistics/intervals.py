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

    @property
    def excludes_0(self) -> bool:
        """Whether the interval has ends and 0 lies outside."""
        return self.low is not None and self.high is not None and not self.low <= 0 <= self.high
