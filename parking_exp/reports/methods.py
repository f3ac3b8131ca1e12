"""The statistical methods of a report, in sentences: only those that it uses."""

from collections.abc import Iterator

from parking_exp.reports.report_data import ReportData
from parking_exp.statistics import unseen_share
from parking_exp.tasks.registry import task_reports

REFERENCES = (
    "Wilson, J. Am. Stat. Assoc. 22 (1927). Clopper & Pearson, Biometrika 26 (1934). Mann & "
    "Whitney, Ann. Math. Stat. 18 (1947). Kaplan & Meier, J. Am. Stat. Assoc. 53 (1958). Holm, "
    "Scand. J. Stat. 6 (1979). Rubin, Ann. Stat. 9 (1981), on the Bayesian bootstrap. Walley, "
    "J. R. Stat. Soc. B 58 (1996). Agarwal et al., NeurIPS (2021), on the interquartile mean."
)


def describe_methods(report: ReportData) -> Iterator[str]:
    """Yield what a reader has to know of each kind of number that the report has."""
    yield (
        "The replicate is the training seed. Each run's last policy, deterministic, is evaluated "
        "from fixed seeds; episodes are never pooled as if they were independent of their run."
    )
    for task in task_reports(report.tasks):
        yield from task.methods
    yield (
        "Intervals of rates are for the mean of all possible seeds: a Bayesian bootstrap of the "
        "seeds and of one unseen seed, at least as wide as Clopper and Pearson's of all episodes. "
        "A single seed has no interval."
    )
    yield "CPU-seconds of a run count everything, its final evaluation and cross-check included."
    yield (
        "All intervals are at 95 %. Shares of episodes have Wilson's, shares of seeds Clopper and "
        "Pearson's."
    )
    fewest = min((cell.success.n for cell in report.cells if cell.success.n), default=0)
    if fewest > 1:
        share = 100 * unseen_share(fewest)
        yield (
            f"Recipes that collapse now and then can hide it: {fewest} seeds without a collapse "
            f"leave room for {share:.0f} % of seeds that do."
        )
    if report.pairs:
        yield (
            f"{report.family} Ranks of seeds have Mann and Whitney's test, with Holm's correction."
        )
    if any(cell.survival for cell in report.cells):
        yield (
            "Time to 90 %: the first step from which three evaluations in a row had 90 % success. "
            "Seeds that do not reach it are right-censored: shares are Kaplan and Meier's, with "
            "Greenwood's interval on the log-log scale."
        )
    if report.effects:
        yield (
            "Main effects are means of cell means, with intervals made likewise; p of the "
            "difference of the best and the worst level, and its interval, have Bonferroni's "
            "correction over the pairs of levels."
        )
    yield REFERENCES
