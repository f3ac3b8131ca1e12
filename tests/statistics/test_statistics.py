"""Numbers of the report: exact values, published tables, and how often intervals cover."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from support import coverage_simulation as simulation
from support.coverage_simulation import Rates
from support.marks import slow_but

from parking_exp.statistics import (
    Interval,
    SeedRates,
    compare,
    interquartile_mean,
    largest_hidden_share,
    main_effects,
    mean_interval,
    normalised_area,
    steps_to,
    wilson_interval,
)
from parking_exp.statistics.permutation import permutation_p

TEN = [0.93, 0.97, 0.88, 1.0, 0.95, 0.91, 0.99, 0.96, 0.72, 0.94]

EPISODES = st.sampled_from([None, 100])
SEEDS = st.lists(
    st.integers(0, 100).map(lambda successes: successes / 100), min_size=2, max_size=12
)


# One rate


def test_ten_seeds_without_a_collapse_leave_room_for_26_percent_of_them():
    assert largest_hidden_share(10) == pytest.approx(0.2589, abs=1e-4)  # 0.7411 ** 10 = 0.05


def test_wilson_interval_is_scipys():
    for successes in (0, 7, 10):
        expected = stats.binomtest(successes, 10).proportion_ci(method="wilson")
        assert wilson_interval(successes, 10) == pytest.approx((expected.low, expected.high))


def test_interquartile_mean_leaves_out_a_quarter_at_each_end():
    assert interquartile_mean([0.0, 1.0, 0.7, 0.8, 0.9]) == pytest.approx(0.8)
    assert interquartile_mean([0.2, 0.8, 0.6]) == pytest.approx(1.6 / 3)


# Means


def test_perfect_seeds_have_the_exact_bound_of_all_their_episodes():
    perfect = mean_interval([1.0] * 10, 500)
    assert (perfect.value, perfect.high, perfect.n) == (1.0, 1.0, 10)
    assert perfect.low == pytest.approx(0.025 ** (1 / 5000), abs=4e-8)
    # interpolated between quantiles of a Beta distribution
    assert mean_interval([0.0] * 10, 500).high == pytest.approx(1 - 0.025 ** (1 / 5000), rel=5e-5)
    same = mean_interval([0.99] * 10, 500)
    exact = tuple(stats.binomtest(4950, 5000).proportion_ci())
    assert (same.low, same.high) == pytest.approx(exact, abs=1e-6)


def test_one_seed_has_no_interval():
    assert mean_interval([0.7], 500) == Interval(0.7, None, None, 1)


def test_interval_of_a_mean_agrees_with_draws_of_the_model():
    weights = np.random.default_rng(3).dirichlet([0.8] * 10 + [0.05], 400_000)  # (10 - 2) / 10
    # 0.72 - 3 * 0.28 is below 0, so the unseen seed is at 0 for the lower end, 1 for the upper one.
    low = np.quantile(weights @ [*TEN, 0], 0.025)
    high = np.quantile(weights @ [*TEN, 1], 0.975)
    estimate = mean_interval(TEN)
    assert (estimate.low, estimate.high) == pytest.approx((low, high), abs=0.002)


@pytest.mark.parametrize("alpha", [0.05, 0.001, 1e-6])
def test_equal_seeds_have_the_exact_quantile_of_a_beta_distribution(alpha):
    # The weight of the unseen seed, 0.1 away, has the distribution Beta(1 / 20, 1).
    away = 0.1 * (1 - alpha / 2) ** 20
    estimate = mean_interval([0.5] * 3, alpha=alpha)
    assert (estimate.low, estimate.high) == pytest.approx((0.5 - away, 0.5 + away), abs=1e-7)


def test_three_and_five_seeds_in_the_middle_that_agree_have_narrow_intervals():
    three = mean_interval([0.50, 0.52, 0.51], 500)
    assert three.high - three.low == pytest.approx(0.134, abs=5e-4)
    five = mean_interval([0.48, 0.49, 0.50, 0.51, 0.52], 500)
    assert five.high - five.low == pytest.approx(0.077, abs=5e-4)


@pytest.mark.parametrize("value", [math.nan, 1.5, -0.1])
def test_mean_interval_refuses_values_that_are_no_rates(value):
    with pytest.raises(ValueError, match="rates lie outside"):
        mean_interval([0.5, value])


@settings(max_examples=60, deadline=None)
@given(SEEDS, EPISODES)
def test_intervals_hold_the_mean_and_are_those_of_failures_upside_down(rates, n_episodes):
    interval = mean_interval(rates, n_episodes)
    assert 0 <= interval.low <= interval.value + 1e-12
    assert interval.value - 1e-12 <= interval.high <= 1
    failures = mean_interval([1 - rate for rate in rates], n_episodes)
    mirrored = (1 - interval.high, 1 - interval.low)
    assert (failures.low, failures.high) == pytest.approx(mirrored, abs=1e-6)


@settings(max_examples=20, deadline=None)
@given(SEEDS, st.randoms(), EPISODES)
def test_interval_is_the_same_in_every_call_and_order_of_the_seeds(rates, random, n_episodes):
    first = mean_interval(rates, n_episodes)
    shuffled = mean_interval(random.sample(rates, len(rates)), n_episodes)
    assert first == mean_interval(rates, n_episodes)
    assert (first.low, first.high) == (shuffled.low, shuffled.high)


# Pairs


def enumerate_assignments(strata, rounding=1e-9):
    """p by the definition: the share of all assignments that are as far apart."""
    differences = [0.0]
    observed = 0.0
    for a, b in strata:
        pooled = np.array([*a, *b])
        observed += np.mean(a) - np.mean(b)
        in_stratum = []
        for chosen in itertools.combinations(range(len(pooled)), len(a)):
            is_a = np.isin(np.arange(len(pooled)), chosen)
            in_stratum.append(pooled[is_a].mean() - pooled[~is_a].mean())
        differences = np.add.outer(differences, in_stratum).ravel()
    return np.mean(np.abs(differences) >= abs(observed) - rounding)


@st.composite
def small_strata(draw):
    """One or two pairs of up to five seeds, all with the same number of episodes."""
    n_episodes = draw(st.sampled_from([30, 60, 100, 150, 300, 500, 700, 999]))
    # Often near the ceiling, where ties are frequent.
    lowest = draw(st.sampled_from([0, n_episodes - 7]))
    rate = st.integers(lowest, n_episodes).map(lambda successes: successes / n_episodes)
    cell = st.lists(rate, min_size=1, max_size=5)
    return draw(st.lists(st.tuples(cell, cell), min_size=1, max_size=2))


@settings(max_examples=120, deadline=None)
@given(small_strata())
def test_p_is_the_share_of_all_assignments_and_swapping_the_cells_does_not_change_it(strata):
    p = permutation_p(strata)
    assert p == pytest.approx(enumerate_assignments(strata), abs=1e-12)
    assert permutation_p([(b, a) for a, b in strata]) == pytest.approx(p, abs=1e-12)


@pytest.mark.parametrize(
    ("n_a", "episodes_a", "n_b", "episodes_b"),
    [(5, 500, 5, 499), (7, 7777, 6, 7777), (6, 2000, 4, 9999), (3, 100, 5, 10_000)],
)
def test_p_is_exact_with_many_or_different_numbers_of_episodes(n_a, episodes_a, n_b, episodes_b):
    rng = np.random.default_rng(0)
    for _ in range(5):
        # One to three failures each, so that ties are frequent.
        a = 1 - rng.integers(1, 4, n_a) / episodes_a
        b = 1 - rng.integers(1, 4, n_b) / episodes_b
        p = permutation_p([(a, b)])
        assert p == pytest.approx(enumerate_assignments([(a, b)], 1e-12), abs=1e-12)


def test_rates_of_ten_thousand_episodes_are_told_apart():
    # All ten of one cell are above all ten of the other.
    assert permutation_p([([0.9999] * 10, [0.9996] * 10)]) == pytest.approx(2 / 184_756)


def test_p_of_rates_that_are_no_shares_of_episodes_is_that_of_all_assignments():
    rng = np.random.default_rng(0)
    a = rng.random(6)
    b = 0.2 * rng.random(6)
    assert permutation_p([(a, b)]) == pytest.approx(enumerate_assignments([(a, b)]))


def test_p_of_hundreds_of_seeds_is_exact_if_few_collapse(monkeypatch):
    rng = np.random.default_rng(3)
    cells = []
    for rate in (0.985, 0.98):
        healthy = rng.binomial(500, rate, 200) / 500
        cells.append(np.where(rng.random(200) < 0.05, 0.0, healthy))
    p = permutation_p([tuple(cells)])
    monkeypatch.setattr("parking_exp.statistics.permutation.MAX_COUNTS", 10**12)
    assert permutation_p([tuple(cells)]) == p


def test_p_of_strata_moves_by_less_than_5_percent_where_sums_are_rounded(monkeypatch):
    rng = np.random.default_rng(1)
    strata = []
    for _ in range(2):
        strata.append((rng.binomial(500, 0.9, 10) / 500, rng.binomial(500, 0.88, 9) / 500))
    exact = permutation_p(strata)
    monkeypatch.setattr("parking_exp.statistics.permutation.MAX_SUMMED_STEPS", 10_000)
    rounded = permutation_p(strata)
    assert abs(rounded - exact) > 1e-6
    assert rounded == pytest.approx(exact, rel=0.05)


def test_p_has_the_floor_of_the_number_of_assignments():
    assert permutation_p([([1.0] * 2, [0.0] * 2)]) == pytest.approx(2 / 6)
    assert permutation_p([([1.0] * 5, [0.0] * 5)]) == pytest.approx(2 / 252)
    assert permutation_p([([1.0] * 10, [0.0] * 10)]) == pytest.approx(2 / 184_756)
    assert permutation_p([([1.0] * 700, [0.0] * 700)]) == pytest.approx(0, abs=1e-300)
    assert permutation_p([([0.7] * 10, [0.7] * 10)]) == 1


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(SEEDS, SEEDS), min_size=1, max_size=8), EPISODES)
def test_a_family_has_bonferronis_correction_over_its_pairs_with_four_seeds_of_each(
    family, n_episodes
):
    pairs = [tuple([SeedRates(rates, n_episodes)] for rates in pair) for pair in family]
    n_tested = sum(min(len(a), len(b)) >= 4 for a, b in family)
    alpha = 0.05 / max(n_tested, 1)
    for (a, b), difference in zip(family, compare(pairs), strict=True):
        assert difference.value == pytest.approx(np.mean(a) - np.mean(b))
        # Zou and Donner's interval of a difference
        x = mean_interval(a, n_episodes, alpha)
        y = mean_interval(b, n_episodes, alpha)
        low = difference.value - math.hypot(x.value - x.low, y.high - y.value)
        high = difference.value + math.hypot(x.high - x.value, y.value - y.low)
        assert (difference.low, difference.high) == pytest.approx((low, high))
        if min(len(a), len(b)) < 4:
            assert (difference.p, difference.p_corrected) == (None, None)
        else:
            assert difference.p == permutation_p([(a, b)])
            assert difference.p_corrected == min(1, n_tested * difference.p)


def test_a_pair_with_a_single_seed_has_neither_interval_nor_p_and_is_no_part_of_the_family():
    single = ([SeedRates([0.9])], [SeedRates([0.5, 0.7])])
    other = ([SeedRates(TEN)], [SeedRates([0.5, 0.7, 0.6, 0.6])])
    differences = compare([single, other])
    assert differences[0].value == pytest.approx(0.3)
    assert (differences[0].low, differences[0].p, differences[0].n) == (None, None, 1)
    assert differences[1] == compare([other])[0]
    four_cells = ([SeedRates([0.9])] * 4, [SeedRates([0.5])] * 4)
    (difference,) = compare([four_cells])
    assert (difference.low, difference.p, difference.n) == (None, None, 4)


# Time to a threshold


def test_steps_to_is_the_first_of_three_evaluations_that_hold():
    steps = [0, 10, 20, 30, 40, 50, 60]
    assert steps_to(steps, [0, 0.9, 0.95, 0.8, 0.9, 0.9, 1.0]) == 40.0
    assert steps_to(steps, [0, 0.9, 0.95, math.nan, 0.9, 0.9, 0.1]) is None
    assert steps_to(steps[:2], [1.0, 1.0]) is None
    assert steps_to(steps[:2], [0.0, 1.0], hold=1) == 10.0


# Curves


def test_normalised_area_is_trapezoids_over_the_covered_range():
    assert normalised_area([10, 20, 40], [1, 1, 1]) == 1.0
    # (0 + 1) / 2 * 10 + 1 * 20 = 25 of 30
    assert normalised_area([10, 20, 40], [0, 1, 1]) == pytest.approx(25 / 30)
    assert normalised_area([10, 20, 30, 40], [0, 1, math.nan, 1]) == pytest.approx(25 / 30)
    assert normalised_area([10], [0.3]) == 0.3


# Factor sweeps

CELLS = {
    ("future", 2): [0.2, 0.4],
    ("future", 4): [0.6, 0.8, 0.7],
    ("final", 2): [0.1, 0.1],
    ("final", 4): [0.3, 0.5],
}


def effects_of(factors, cells=CELLS, n_episodes=None):
    return main_effects(
        factors, [(levels, SeedRates(rates, n_episodes)) for levels, rates in cells.items()]
    )


def test_main_effects_weigh_cells_and_not_seeds():
    strategy, goals = effects_of(["strategy", "goals"])
    # cells: future 0.3, 0.7; final 0.1, 0.4
    assert {level.level: level.effect.value for level in strategy.levels} == pytest.approx(
        {"final": 0.25, "future": 0.5}
    )
    assert {level.level: level.effect.value for level in goals.levels} == pytest.approx(
        {2: 0.2, 4: 0.55}
    )
    assert goals.largest.value == pytest.approx(0.35)


def test_effects_are_contrasts_of_all_cells_of_a_level():
    effect = effects_of(["strategy", "goals"], n_episodes=100)[0]
    of_future = [SeedRates(CELLS["future", goals], 100) for goals in (2, 4)]
    of_final = [SeedRates(CELLS["final", goals], 100) for goals in (2, 4)]
    (difference,) = compare([(of_future, of_final)])
    assert effect.largest == difference
    # Seeds are permuted among cells with the same number of goals.
    matched = [(CELLS["future", goals], CELLS["final", goals]) for goals in (2, 4)]
    assert effect.largest.p_corrected == pytest.approx(enumerate_assignments(matched))
    future = effect.levels[1]
    assert (future.level, future.cells, future.effect.n) == ("future", 2, 5)


def test_the_largest_of_three_differences_is_corrected_for_all_of_them():
    cells = {("a",): TEN, ("b",): [0.5, 0.7, 0.6, 0.6], ("c",): [0.4, 0.6, 0.4, 0.4]}
    (effect,) = effects_of(["strategy"], cells)
    a, b, c = ([SeedRates(rates)] for rates in cells.values())
    expected = compare([(a, b), (a, c), (b, c)])[1]
    assert effect.largest == expected
    alone = mean_interval(TEN)
    level = effect.levels[0].effect
    assert (level.value, level.n) == (alone.value, 10)
    assert (level.low, level.high) == pytest.approx((alone.low, alone.high))


def test_levels_with_equal_means_are_compared_with_each_other():
    (effect,) = effects_of(["strategy"], {("a",): [0.0] * 4, ("b",): [0.0] * 4}, n_episodes=100)
    assert (effect.highest.level, effect.lowest.level) == ("a", "b")
    assert (effect.largest.value, effect.largest.p_corrected) == (0.0, 1.0)


def test_a_factor_with_one_level_has_no_effect():
    cells = {("a", 1): [0.5] * 4, ("b", 1): [0.6] * 4}
    assert [effect.factor for effect in effects_of(["strategy", "goals"], cells)] == ["strategy"]


def test_effects_have_no_interval_and_no_p_where_a_cell_has_a_single_seed():
    effect = effects_of(["strategy", "goals"], {**CELLS, ("future", 2): [0.3]})[0]
    assert effect.levels[1].effect.value == pytest.approx(0.5)
    assert effect.levels[1].effect.low is None
    assert (effect.largest.low, effect.largest.p_corrected) == (None, None)


# Coverage


COVERED = [(Rates(0.95, 0.03), 5), (Rates(0.25, 0.15), 10), (Rates(0.98, 0.015), 20)]


@pytest.mark.parametrize(("rates", "n"), slow_but(COVERED[:1], COVERED, several=True))
def test_interval_of_a_mean_covers_in_93_to_97_of_100_draws(rates, n):
    assert 0.93 <= simulation.of_mean(rates, n, 1000).mean() <= 0.97


def test_intervals_of_differences_cover_in_93_to_97_of_100_draws():
    rates = Rates(0.9, 0.08)
    assert 0.93 <= simulation.of_difference(rates, rates, 20, 1000).mean() <= 0.97


@pytest.mark.slow
@pytest.mark.parametrize("episodes", simulation.EPISODES)
@pytest.mark.parametrize(
    ("n", "lowest", "highest"), [(5, 0.91, 1), (10, 0.925, 0.995), (20, 0.93, 0.98)]
)
@pytest.mark.parametrize("rates", simulation.HEALTHY, ids=str)
def test_intervals_of_means_cover_in_93_of_100_draws_and_in_91_with_5_seeds(
    rates, n, lowest, highest, episodes
):
    covered = simulation.of_mean(rates, n, episodes=episodes).mean()
    assert covered >= lowest
    assert covered <= highest or rates.mean >= 0.999


@pytest.mark.slow
@pytest.mark.parametrize("episodes", simulation.EPISODES)
@pytest.mark.parametrize(
    ("n", "tailed", "collapsing"), [(5, 0.64, 0.52), (10, 0.73, 0.64), (20, 0.82, 0.85)]
)
def test_intervals_of_means_cover_less_where_few_seeds_are_far_below_the_others(
    n, tailed, collapsing, episodes
):
    for populations, lowest in ((simulation.TAILED, tailed), (simulation.COLLAPSING, collapsing)):
        covered = [simulation.of_mean(rates, n, episodes=episodes).mean() for rates in populations]
        assert lowest <= min(covered) < 0.93


@pytest.mark.slow
@pytest.mark.parametrize("episodes", simulation.EPISODES)
@pytest.mark.parametrize("n", simulation.SEEDS)
def test_differences_cover_in_92_of_100_draws_and_less_where_one_side_has_a_tail(n, episodes):
    for pairs, lowest in (
        (simulation.PAIRS, 0.92),
        (simulation.SKEWED_PAIRS, {5: 0.75, 10: 0.8, 20: 0.87}[n]),
    ):
        for pair in pairs:
            assert simulation.of_difference(*pair, n, episodes=episodes).mean() >= lowest, pair


# How often the test errs


def highest_share(level, draws):
    """1.2 times the level, and three standard errors of the simulation."""
    share = 1.2 * level
    return share + 3 * math.sqrt(share * (1 - share) / draws)


def test_a_verdict_of_ten_pairs_does_not_tell_40_from_50_percent_with_ten_seeds_and_of_one_does():
    pair = (Rates(0.4, 0.05), Rates(0.5, 0.05))
    assert not simulation.decides(*pair, 10, n_pairs=10, draws=40).any()
    assert simulation.decides(*pair, 10, n_pairs=1, draws=40).mean() > 0.75


def test_equal_cells_of_which_one_seed_in_ten_collapses_rarely_differ_significantly():
    rates = Rates(0.99, 0.01, failing=0.1)
    p = simulation.p_values(rates, rates, 10, 1000)
    assert (p <= 0.05).mean() <= highest_share(0.05, 1000)


@pytest.mark.slow
@pytest.mark.parametrize("n", simulation.SEEDS)
@pytest.mark.parametrize("rates", [pair[0] for pair in simulation.EQUAL], ids=str)
def test_equal_cells_differ_significantly_no_more_often_than_the_level_says(rates, n):
    draws = 10_000
    p = simulation.p_values(rates, rates, n, draws)
    for level in simulation.LEVELS:
        assert (p <= level).mean() <= highest_share(level, draws)


def test_ten_seeds_tell_90_from_95_percent():
    p = simulation.p_values(Rates(0.9, 0.03), Rates(0.95, 0.03), 10, 400)
    assert (p <= 0.05).mean() > 0.65
