"""The statistical methods of a report, in sentences: only those that it uses."""

from collections.abc import Iterator

from parking_exp.reports.report_data import ReportData
from parking_exp.statistics import ENOUGH_FOR_A_TEST, unseen_share
from parking_exp.tasks.registry import task_reports

REFERENCES = (
    "Clopper & Pearson, Biometrika 26 (1934). Fisher, The Design of Experiments (1935). Mann & "
    "Whitney, Ann. Math. Stat. 18 (1947). Rubin, "
    "Ann. Stat. 9 (1981), on the Bayesian bootstrap. Pagano & Tritchler, J. Am. Stat. Assoc. 78 "
    "(1983), on exact permutation tests. Walley, J. R. Stat. Soc. B 58 (1996). Zou & Donner, Stat. "
    "Med. 27 (2008), on intervals of differences. Agarwal et al., NeurIPS (2021), on the "
    "interquartile mean."
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
        "Intervals are at 95 %, and are for the mean over all possible seeds. They come from a "
        "Bayesian bootstrap of the seeds and of one unseen seed. They are at least as wide as "
        "Clopper and Pearson's interval of all episodes. Below ten seeds they are compatibility "
        "intervals: they show which means are compatible with the seeds, and cover less than 95 % "
        "where seeds collapse. A single seed has no interval."
    )
    if any(cell.total_timesteps == 0 for cell in report.cells):
        yield (
            "What is not trained has no env steps. With a single seed, the intervals of its rates "
            "are Wilson's, over its episodes."
        )
    yield "CPU-seconds of a run count its evaluations and its cross-check, but no imports."
    fewest = min((cell.success.n for cell in report.cells if cell.success.n), default=0)
    if fewest > 1:
        share = 100 * unseen_share(fewest)
        yield (
            f"A few seeds do not show rare collapses: if none of {fewest} seeds collapses, up to "
            f"{share:.0f} % of all seeds still may."
        )
    if report.pairs:
        yield (
            f"{report.family} A verdict needs {ENOUGH_FOR_A_TEST} seeds of each cell, and is "
            "“unclear” where only one of test and interval finds a difference. As a second "
            "opinion, tables have Mann and Whitney's test of ranks, with the same correction."
        )
    if any(cell.n_timed for cell in report.cells):
        yield (
            "Time to 90 %: the first step from which three evaluations in a row had 90 % success "
            "or more. Its median is over all seeds, also those that do not reach it."
        )
    if report.effects:
        yield (
            "A main effect is a mean of cell means, and its interval is made in the same way. The "
            "best and the worst level are compared by the same test. It permutes seeds among cells "
            "that are equal otherwise, and has Bonferroni's correction over the pairs of levels."
        )
    yield REFERENCES
