"""Numbers of the report: exact values, published tables, and how often intervals cover."""

import math
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from scipy import optimize, stats
from support import coverage_simulation as simulation
from support.coverage_simulation import Rates

from parking_exp.statistics import (
    Interval,
    coverage_note,
    holm,
    kaplan_meier,
    log_rank,
    main_effects,
    mean_band,
    mean_interval,
    normalised_area,
    probability_of_improvement,
    restricted_mean,
    share_reaching,
    steps_to,
    student_interval,
    unseen_share,
    welch,
    wilson_interval,
)
from parking_exp.statistics.intervals import score_interval

# Freireich et al. 1963, weeks of remission, as in Klein & Moeschberger: 6-MP (with censoring) and placebo.
MERCAPTOPURINE = (
    [6, 6, 6, 6, 7, 9, 10, 10, 11, 13, 16, 17, 19, 20, 22, 23, 25, 32, 32, 34, 35],
    [1, 1, 1, 0, 1, 0, 1, 0, 0, 1, 1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0],
)
PLACEBO = ([1, 1, 2, 2, 3, 4, 4, 5, 5, 8, 8, 8, 8, 11, 11, 12, 12, 15, 17, 22, 23], [1] * 21)

# Welch's test on Wikipedia, "Student's t-test", example 1: t = -2.46, df = 25.0, p = 0.021.
FIRST = [27.5, 21.0, 19.0, 23.6, 17.0, 17.9, 16.9, 20.1, 21.9, 22.6, 23.1, 19.6, 19.0, 21.7, 21.4]
SECOND = [27.1, 22.0, 20.8, 23.4, 23.4, 23.5, 25.8, 22.0, 24.8, 20.2, 21.9, 22.1, 22.9, 20.5, 24.4]

TEN = [0.93, 0.97, 0.88, 1.0, 0.95, 0.91, 0.99, 0.96, 0.72, 0.94]


def test_importing_statistics_imports_neither_scipy_stats_nor_pandas():
    code = "import sys, parking_exp.statistics; print(sorted({'scipy.stats', 'pandas', 'torch'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


# One rate


@pytest.mark.parametrize(("k", "n", "low", "high"), [(95, 100, 0.89, 0.98), (475, 500, 0.93, 0.97)])
def test_a_share_of_seeds_counts_those_at_the_threshold_and_has_wilsons_interval(k, n, low, high):
    share = share_reaching([0.9] * k + [0.89] * (n - k))
    assert (share.k, share.n) == (k, n)
    assert [round(share.low, 2), round(share.high, 2)] == [low, high]


# Means


def test_seeds_without_scatter_get_the_exact_bound_and_where_there_is_none_no_interval():
    estimate = mean_interval([1.0] * 10)
    assert estimate.low == pytest.approx(stats.binomtest(10, 10).proportion_ci().low)  # 0.69
    assert (estimate.high, estimate.method) == (1.0, "exact bound, no scatter")
    assert mean_interval([0.7]) == Interval(0.7, None, None, 1, "none")
    assert student_interval([12.0] * 3) == Interval(12.0, None, None, 3, "none")
    assert unseen_share(10) == pytest.approx(0.2589, abs=1e-4)  # 0.7411 ** 10 = 0.05


def test_interval_of_any_numbers_is_students():
    estimate = student_interval(FIRST)
    expected = stats.ttest_1samp(FIRST, 0).confidence_interval()
    assert [estimate.low, estimate.high] == pytest.approx([expected.low, expected.high])


def test_score_interval_with_a_coins_variance_is_wilsons():
    low, high = score_interval(np.array(0.9), np.array(0.9 * 0.1 / 10), 1e12)
    assert (float(low), float(high)) == pytest.approx(wilson_interval(9, 10))


def test_interval_of_two_seeds_by_hand():
    # mean 0.9, variance of the mean 0.02 / 2 = 0.01, so 0.09 / 0.01 = 9 trials; t = 12.70620, t^2 = 161.4476
    # scale 1 / (1 + 161.4476 / 9) = 0.0528021; centre 0.0528021 (0.9 + 161.4476 / 18) = 0.521121
    # half 0.0528021 * 12.70620 * sqrt(0.01 + 161.4476 / 324) = 0.478327
    estimate = mean_interval([0.8, 1.0])
    assert [estimate.low, estimate.high] == pytest.approx([0.042794, 0.999448], abs=2e-6)
    assert estimate.method == "score, effective sample size"


def test_bootstrap_t_agrees_with_drawing_indices():
    values, rng = np.array(TEN), np.random.default_rng(11)
    drawn = values[rng.integers(0, 10, (100_000, 10))]
    deviations = (drawn.mean(axis=1) - values.mean()) / (drawn.std(axis=1, ddof=1) / math.sqrt(10))
    below, above = np.quantile(deviations, [0.025, 0.975])
    error = values.std(ddof=1) / math.sqrt(10)
    estimate = mean_interval(TEN, resamples=100_000)
    assert estimate.method == "bootstrap-t"
    assert estimate.low == pytest.approx(values.mean() - above * error, abs=0.004)
    assert estimate.high == pytest.approx(values.mean() - below * error, abs=0.004)


@pytest.mark.parametrize(
    ("values", "words"),
    [([], "finite"), ([0.5, math.nan], "finite"), ([0.5, 1.5], "outside 0 ... 1")],
)
def test_mean_interval_refuses_values_that_are_no_rates(values, words):
    with pytest.raises(ValueError, match=words):
        mean_interval(values)


def test_band_is_the_interval_of_every_point_and_counts_the_seeds_that_it_has():
    curves = np.array([TEN, TEN[::-1], [0.5] * 10, [0.6] * 9 + [math.nan], [0.7] * 9 + [math.nan]])
    band = mean_band(curves)
    for point, column in ((band[0], curves[:, 0]), (band[9], curves[:3, 9])):
        alone = mean_interval(column, resamples=1999)
        assert (point.value, point.low, point.high) == pytest.approx((alone.value, alone.low, alone.high))
    assert [estimate.n for estimate in band] == [5] * 9 + [3]
    assert mean_band(np.full((2, 1), math.nan))[0].n == 0


# Pairs


def test_welch_agrees_with_the_published_example():
    result = welch(FIRST, SECOND)
    assert round(result.df, 1) == 25.0
    assert round(result.p, 3) == 0.021
    expected = stats.ttest_ind(FIRST, SECOND, equal_var=False)
    assert result.p == pytest.approx(expected.pvalue)
    interval = expected.confidence_interval()
    assert [result.low, result.high] == pytest.approx([interval.low, interval.high])


def test_welch_without_scatter_has_no_interval_and_the_p_of_a_permutation():
    result = welch([0.9], [0.5, 0.7])
    assert (result.value, result.low, result.high, result.p) == (pytest.approx(0.3), None, None, None)
    result = welch([1.0] * 3, [1.0] * 4)
    assert (result.value, result.low, result.p) == (0.0, None, 1.0)
    assert welch([1.0] * 3, [0.5] * 3).p == pytest.approx(2 / 20)  # 6! / (3! 3!) = 20 ways to split


def test_ties_count_one_half():
    # 1 beats 0; each 2 beats 0 and ties with 2: 1 + 2 * 1.5 = 4 of 9
    assert probability_of_improvement([1, 2, 2], [0, 2, 3]).value == pytest.approx(4 / 9)
    assert probability_of_improvement([0, 2, 3], [1, 2, 2]).value == pytest.approx(5 / 9)


def test_improvement_interval_solves_newcombes_equation():
    result = probability_of_improvement([1, 2, 2, 5], [0, 2, 3])
    theta, size, z = result.value, 3.5, stats.norm.ppf(0.975)

    def distance(x):
        variance = x * (1 - x) / 12 * (1 + (size - 1) * ((1 - x) / (2 - x) + x / (1 + x)))
        return (theta - x) ** 2 - z**2 * variance

    assert result.low == pytest.approx(optimize.brentq(distance, 1e-9, theta))
    assert result.high == pytest.approx(optimize.brentq(distance, theta, 1 - 1e-9))
    certain = probability_of_improvement([1] * 5, [0] * 5)
    assert (certain.value, certain.high) == (1.0, 1.0)
    assert 0.5 < certain.low < 0.8


def test_holm_by_hand_and_without_nan_in_the_family():
    # sorted 0.005 * 4, 0.01 * 3, 0.03 * 2, max(0.06, 0.04 * 1)
    assert holm([0.01, 0.04, 0.03, 0.005]).tolist() == pytest.approx([0.03, 0.06, 0.06, 0.02])
    adjusted = holm([0.01, math.nan, 0.6, 0.7])
    assert math.isnan(adjusted[1])
    assert adjusted[[0, 2, 3]].tolist() == pytest.approx([0.03, 1.0, 1.0])
    assert holm([]).tolist() == []
    with pytest.raises(ValueError, match="between 0 and 1"):
        holm([1.2])


# Time to a threshold


def test_steps_to_is_the_first_of_three_evaluations_that_hold():
    steps = [0, 10, 20, 30, 40, 50, 60]
    assert steps_to(steps, [0, 0.9, 0.95, 0.8, 0.9, 0.9, 1.0]) == (40.0, True)
    assert steps_to(steps, [0, 0.9, 0.95, math.nan, 0.9, 0.9, 0.1]) == (40.0, False)
    assert steps_to(steps[:2], [1.0, 1.0]) == (0.0, False)
    assert steps_to(steps[:2], [0.0, 1.0], hold=1) == (10.0, True)


def test_kaplan_meier_agrees_with_the_leukaemia_table():
    curve = kaplan_meier(*MERCAPTOPURINE)
    survival = {time: round(1 - reached, 3) for time, reached in zip(curve.times, curve.reached, strict=True)}
    published = {6: 0.857, 7: 0.807, 10: 0.753, 13: 0.690, 16: 0.627, 22: 0.538, 23: 0.448, 35: 0.448}
    assert {time: survival[time] for time in published} == published
    assert (curve.median, curve.n, curve.k) == (23.0, 21, 9)
    assert kaplan_meier(*PLACEBO).median == 8.0


def test_kaplan_meier_without_events_and_with_nothing_else():
    never = kaplan_meier([50, 50, 50], [False] * 3)
    assert (never.reached, never.median, never.low) == ((0.0,), None, (0.0,))
    assert never.high == (wilson_interval(0, 3)[1],)
    always = kaplan_meier([10, 10], [True, True])
    assert (always.reached, always.median, always.high) == ((1.0,), 10.0, (1.0,))
    assert always.low == (wilson_interval(2, 2)[0],)
    curve = kaplan_meier([10, 20, 30], [True] * 3)
    assert all(a <= b for a, b in pairwise(curve.low))
    assert not any(math.isnan(number) for number in (*curve.low, *curve.high))


def test_log_rank_agrees_with_the_published_leukaemia_trial_and_needs_an_event():
    assert log_rank(MERCAPTOPURINE, PLACEBO) == pytest.approx(stats.chi2.sf(16.79, 1), rel=0.01)  # chi-square 16.79
    assert log_rank(([5, 5], [0, 0]), ([5], [0])) is None


def test_restricted_mean_is_the_mean_of_times_cut_at_the_horizon():
    result, share = restricted_mean([10, 30, 70, 90], 50), mean_interval([0.2, 0.6, 1.0, 1.0])
    assert (result.value, result.low, result.high) == pytest.approx((35.0, 50 * share.low, 50 * share.high))


# Curves


def test_normalised_area_is_trapezoids_over_the_covered_range():
    assert normalised_area([10, 20, 40], [1, 1, 1]) == 1.0
    # (0 + 1) / 2 * 10 + 1 * 20 = 25 of 30
    assert normalised_area([10, 20, 40], [0, 1, 1]) == pytest.approx(25 / 30)
    assert normalised_area([10, 20, 30, 40], [0, 1, math.nan, 1]) == pytest.approx(25 / 30)
    assert normalised_area([10], [0.3]) == 0.3
    with pytest.raises(ValueError, match="at least one evaluation"):
        normalised_area([10], [math.nan])


# Factor sweeps

CELLS = {("future", 2): [0.2, 0.4], ("future", 4): [0.6, 0.8, 0.7], ("final", 2): [0.1, 0.1], ("final", 4): [0.3, 0.5]}


def frame(cells=CELLS):
    rows = [(*cell, value) for cell, values in cells.items() for value in values]
    return pd.DataFrame(rows, columns=["strategy", "goals", "success"])


def test_main_effects_weigh_cells_and_not_seeds():
    strategy, goals = main_effects(frame(), ["strategy", "goals"], "success")
    # cells: future 0.3, 0.7; final 0.1, 0.4
    assert {level.level: level.effect.value for level in strategy.levels} == pytest.approx(
        {"final": 0.25, "future": 0.5}
    )
    assert {level.level: level.effect.value for level in goals.levels} == pytest.approx({2: 0.2, 4: 0.55})
    assert strategy.complete
    assert goals.largest.value == pytest.approx(0.35)


def test_main_effect_interval_by_hand():
    _, future = main_effects(frame(), ["strategy", "goals"], "success")[0].levels
    # variances 0.02 / 2 and 0.01 / 3, each / 4: 0.0025 + 0.00083333; df = 0.0033333^2 / (0.0025^2 / 1 + 0.00083333^2 / 2)
    df = 0.00333333**2 / (0.0025**2 + 0.00083333**2 / 2)
    half = stats.t.ppf(0.975, df) * math.sqrt(0.00333333)
    assert (future.effect.low, future.effect.high) == pytest.approx((0.5 - half, 0.5 + half), rel=1e-4)
    assert (future.cells, future.effect.n) == (2, 5)


def test_effects_flag_missing_combinations_and_have_no_interval_without_scatter():
    cells = {key: values for key, values in CELLS.items() if key != ("final", 4)} | {("future", 2): [0.3]}
    effect = main_effects(frame(cells), ["strategy", "goals"], "success")[0]
    assert not effect.complete
    assert (effect.levels[1].effect.value, effect.levels[1].effect.low) == (pytest.approx(0.5), None)  # a single seed
    # Three times 0.8 has a variance of 1e-32 in floats.
    (same,) = main_effects(frame({("a", 1): [0.8] * 3, ("b", 1): [0.4] * 3}), ["strategy"], "success")
    assert (same.levels[0].effect.low, same.largest.low, same.p) == (None, None, None)


# Coverage


@pytest.mark.parametrize(("rates", "n"), [(Rates(0.75, 0.05), 10), (Rates(0.9, 0.15), 5), (Rates(0.95, 0.06), 20)])
def test_interval_of_a_mean_covers_in_93_to_97_of_100_draws(rates, n):
    assert 0.93 <= simulation.of_mean(rates, n).mean() <= 0.97


def test_intervals_of_differences_and_improvements_cover_in_93_to_97_of_100_draws():
    narrow, wide = (Rates(0.75, 0.05), Rates(0.9, 0.03)), (Rates(0.95, 0.06), Rates(0.95, 0.06))
    assert 0.93 <= simulation.of_difference(*narrow, 10).mean() <= 0.97
    assert 0.93 <= simulation.of_improvement(*wide, 10).mean() <= 0.97


def test_note_speaks_exactly_where_a_collapse_shows():
    rates = Rates(0.95, 0.03, failing=0.1)
    assert simulation.of_mean(rates, 10).mean() < 0.93
    assert np.array_equal(simulation.speaks(rates, 10), (rates.measured(10, 400, seed=2) == 0).any(axis=1))


def test_welch_falls_below_93_percent_where_the_noisier_cell_has_a_tail():
    assert 0.79 <= simulation.of_difference(Rates(0.95, 0.1), Rates(0.99, 0.01), 10).mean() < 0.84


def test_note_is_silent_on_healthy_seeds_and_names_the_coverage_on_others():
    assert coverage_note(TEN) is None
    assert "fewer than 5" in coverage_note([0.9, 0.95])
    assert "95 points apart" in coverage_note([0.0, 0.95, 0.96, 0.97, 0.98, 0.95])
    assert "covered 62 %" in coverage_note([0.0, 0.95, 0.96, 0.97, 0.98, 0.95])


@pytest.mark.slow
@pytest.mark.parametrize("n", simulation.SEEDS)
@pytest.mark.parametrize("rates", simulation.HEALTHY, ids=str)
def test_mean_never_covers_less_than_93_of_100_draws_and_more_than_97_only_at_the_ceiling_or_with_three(rates, n):
    covered = simulation.of_mean(rates, n).mean()
    assert covered >= 0.93
    assert covered <= 0.9705 or rates.mean == 0.99 or n == 3


@pytest.mark.slow
@pytest.mark.parametrize("n", simulation.SEEDS[1:])
@pytest.mark.parametrize("pair", simulation.PAIRS, ids=str)
def test_differences_and_improvements_cover_in_92_of_100_draws_from_five_seeds_on(pair, n):
    assert simulation.of_difference(*pair, n).mean() >= 0.93
    assert simulation.of_improvement(*pair, n).mean() >= 0.925  # 92.8 % where the deviations are 0.05 and 0.15


def test_the_difference_of_two_levels_of_one_factor_is_welchs_test():
    table = pd.DataFrame(
        {"strategy": ["a"] * 4 + ["b"] * 5, "success": [0.9, 0.8, 0.95, 0.7, 0.5, 0.6, 0.2, 0.4, 0.55]}
    )
    (effect,) = main_effects(table, ["strategy"], "success")
    difference = effect.largest
    a, b = (table.loc[table["strategy"] == name, "success"] for name in "ab")
    known = stats.ttest_ind(a, b, equal_var=False)
    interval = known.confidence_interval()
    assert (difference.value, effect.p) == pytest.approx((a.mean() - b.mean(), known.pvalue))
    assert (difference.low, difference.high) == pytest.approx((interval.low, interval.high))
