"""The content of a report, built from frames."""

import json
from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd
import pytest
import scipy.stats
from support.result_frames import ALGORITHMS, REPLAY, Run, results, together

from parking_exp.errors import ConfigError, RunNotFoundError
from parking_exp.reports.cell_selection import choose_cells, group_runs
from parking_exp.reports.report_builder import build_report
from parking_exp.reports.report_warnings import find_caveats
from parking_exp.reports.sections import section_contents
from parking_exp.reports.tables import report_tables
from parking_exp.statistics import Interval, SeedRates, compare

ENDS = {"sac": [0.8, 1.0, 0.8, 1.0, 1.0], "td3": [0.4, 0.2, 0.4, 0.6, 0.4]}
GOALS = {str(n): {"buffer.n_sampled_goal": n} for n in (1, 2, 4)}


def crossed(strategies=("future", "final"), goals=(1, 4)):
    return {
        f"{name}{n}": {"buffer.name": f"her_{name}", "buffer.n_sampled_goal": n}
        for name in strategies
        for n in goals
    }


def content(configs, seeds=range(3), look=lambda label, seed: Run(), **options):
    return build_report(results(configs, seeds, look), ["one"], **options)


def with_success(rates):
    """Runs of these final rates, by label and seed."""
    return lambda label, seed: Run(success=rates[label][seed])


def by_seed(*runs):
    """The same runs in every cell."""
    return lambda label, seed: runs[seed]


@pytest.fixture(scope="module")
def two():
    """Two algorithms with five seeds each."""
    return content(ALGORITHMS, range(5), with_success(ENDS))


def test_the_headline_is_the_mean_over_seeds_of_the_final_rate(two):
    sac, td3 = two.cells
    assert (sac.label, td3.label) == ("sac", "td3")
    assert (sac.success.value, td3.success.value) == pytest.approx((0.92, 0.4))
    assert (sac.success.n, sac.counts["done"], sac.seeds[0].n_episodes) == (5, 5, 5)
    assert sac.success.low < 0.92 < sac.success.high
    assert [seed.success for seed in sac.seeds] == ENDS["sac"]
    assert sac.metrics["timeout"].value == pytest.approx(0.08)
    assert sac.reaching_95 == 3
    assert sac.lowest == 0.8
    assert sac.iqm == pytest.approx(2.8 / 3)  # without the highest and the lowest of five
    slots = sac.task_data["slots"]
    assert sum(slot["n"] for slot in slots) == 25
    assert sum(slot["n"] * slot["timeout"] for slot in slots) == pytest.approx(2)


def test_a_cell_has_the_paths_of_its_run_with_the_outcomes_and_report_json_has_none():
    paths = pd.DataFrame({"run_id": "one-sac-0", "scene": [0, 0, 4], "step": [0, 1, 0]})
    paths = paths.assign(x_m=[0.0, 1.0, 0.0], y_m=[0.0, -1.0, 0.0], heading_rad=0.5)
    frames = replace(results(ALGORITHMS, range(2)), paths=paths)
    made = build_report(frames, ["one"])
    sac, td3 = made.cells
    assert sac.figure_data.paths["outcome"].tolist() == ["success", "success", "timeout"]
    assert sac.figure_data.paths[["x_m", "y_m"]].to_numpy().tolist() == [[0, 0], [1, -1], [0, 0]]
    assert td3.figure_data.paths.empty
    assert "x_m" not in json.dumps(made.plain())


def test_pairs_are_compared_and_have_a_verdict(two):
    (pair,) = two.pairs
    (expected,) = compare([([SeedRates(ENDS["sac"], 5)], [SeedRates(ENDS["td3"], 5)])])
    assert pair.difference == expected
    assert pair.difference.value == pytest.approx(0.52)
    assert expected.p_corrected == expected.p < 0.05  # a family of one
    rank_p = scipy.stats.mannwhitneyu(ENDS["sac"], ENDS["td3"]).pvalue
    assert pair.rank_p == rank_p
    assert pair.verdict == "a"


def test_claims_have_the_better_cell_the_difference_and_its_p_value(two):
    best, difference = two.claims
    assert best.startswith("sac has the highest final success: 92.0 % [")
    assert difference == "sac is better than td3 (+52.0 points [+23.3, +72.3], p = 0.008)."
    few = "Exploratory: fewer than 10 finished seeds in 2 of 2 cells (the fewest: 5)."
    assert f"{few} Their intervals are compatibility intervals." in two.warnings


def test_ranks_are_a_second_opinion():
    starts = {"sac": [0.0, *([0.99] * 9)], "td3": [0.95] * 10}
    (pair,) = content(ALGORITHMS, range(10), with_success(starts)).pairs
    # Nine of the ten seeds are better, one is at 0: sums of seeds are as far apart in 17 of 20.
    assert (pair.verdict, pair.difference.p) == ("same", pytest.approx(1.0))
    assert pair.rank_p < 0.001


def test_a_verdict_needs_four_seeds_of_each_cell():
    look = with_success({"sac": [1.0] * 3, "td3": [0.2] * 3})
    report = content(ALGORITHMS, range(3), look)
    (pair,) = report.pairs
    assert (pair.verdict, pair.difference.p, pair.rank_p) == ("unknown", None, None)
    words = "sac cannot be compared with td3: that needs 4 finished seeds of each."
    assert report.claims[1] == words


def test_a_verdict_is_unclear_where_only_the_interval_finds_a_difference():
    look = with_success({"1": [0.2] * 4, "2": [0.2] * 4, "4": [1.0] * 4})
    report = content(GOALS, range(4), look)
    verdicts = {(pair.a, pair.b): pair.verdict for pair in report.pairs}
    assert verdicts == {("c0", "c1"): "same", ("c0", "c2"): "unclear", ("c1", "c2"): "unclear"}
    assert report.pairs[1].difference.high < 0
    # Four against four have 70 assignments, of which 2 are as far apart, and there are 3 pairs.
    assert report.pairs[1].difference.p_corrected == pytest.approx(3 * 2 / 70)
    assert report.claims[1].startswith("n_sampled_goal=4 may differ from n_sampled_goal=1 (+80.0")


def test_ten_healthy_seeds_have_no_warning():
    ends = np.random.default_rng(0).choice([0.4, 0.6, 0.8], 10)
    assert content({"sac": {}}, range(10), with_success({"sac": ends})).warnings == []


def test_with_a_baseline_the_family_is_all_others_against_it():
    look = with_success(
        {"1": [0.2, 0.4, 0.4, 0.4], "2": [0.4, 0.6, 0.6, 0.6], "4": [0.8, 1.0, 1.0, 1.0]}
    )
    report = content(GOALS, range(4), look, baseline="n_sampled_goal=2")
    assert matched(report) == {
        ("n_sampled_goal=1", "n_sampled_goal=2"),
        ("n_sampled_goal=4", "n_sampled_goal=2"),
    }
    for pair in report.pairs:
        difference = pair.difference
        assert difference.p_corrected == pytest.approx(min(2 * difference.p, 1))
    assert len(content(GOALS, range(4), look).pairs) == 3


def test_cells_that_do_not_differ_significantly_are_not_ranked():
    ends = {"sac": [0.8, 1.0, 0.6, 0.8], "td3": [0.8, 0.8, 0.6, 0.8]}
    report = content(ALGORITHMS, range(4), with_success(ends))
    assert report.pairs[0].verdict == "same"
    assert "td3 (+5.0 points [" in report.claims[1]
    assert not any("is better than" in claim for claim in report.claims)
    tied = content(ALGORITHMS, range(2), by_seed(Run(1.0), Run(0.8)))
    assert tied.claims[0].startswith("sac and td3 have the same final success, the highest: 90.0 %")


def test_mixed_conditions_are_warned_of():
    conditions = {
        "total_timesteps": 800,
        "evaluation.final_n_scenes": 8,
        "evaluation.first_scene": 100,
        "evaluation.n_scenes": 4,
        "evaluation.every_n_steps": 200,
        "env.vehicles_count": 10,
    }
    columns = {"version.highway-env": "1.11.0", "cpu": "other", "git_commit": "b" * 40}
    configs = {"plain": {}, **{key: {key: value} for key, value in conditions.items()}}
    report = content(configs, range(2), by_seed(Run(), Run(columns=columns)))
    mixed = [line for line in report.warnings if line.startswith("Mixed")]
    assert mixed == [
        "Mixed highway-env: 1.12.1 and 1.11.0.",
        "Mixed commits: aaaaaaaaaa and bbbbbbbbbb.",
        "Mixed machines, whose CPU-seconds cannot be compared: a CPU and other.",
        "Mixed final episodes: 5 and 8.",
        "Mixed evaluation.every_n_steps: 100 and 200.",
        "Mixed evaluation.first_scene: 0 and 100.",
        "Mixed evaluation.n_scenes: 3 and 4.",
        "Mixed total_timesteps: 400 and 800.",
        "Mixed tasks, whose rates are not of the same episodes: env.vehicles_count differ.",
    ]
    assert report.provenance.versions["highway-env"] == {"1.12.1": 7, "1.11.0": 7}


def test_a_cell_that_is_not_trained_mixes_no_budgets():
    report = content(
        {"short": {}, "long": {"total_timesteps": 800}}, range(2), by_seed(Run(), Run())
    )
    assert "Mixed total_timesteps: 400 and 800." in report.warnings
    short, long = report.cells
    untrained = replace(report, cells=[replace(short, total_timesteps=0), long])
    assert not any(line.startswith("Mixed") for line in find_caveats(untrained))


def test_other_rewards_and_simulators_are_no_mixed_tasks():
    other_reward = {
        "env.name": "parking_sparse",
        "env.reward": "sparse",
        "env.collision_reward": -20.0,
        "env.simulator": "highway_env",
    }
    assert not any("Mixed" in line for line in content({"a": {}, "b": other_reward}).warnings)


def test_a_cell_with_only_failed_runs_has_no_numbers_and_its_reasons():
    def look(label, seed):
        return Run(status="failed", error="ValueError: no way") if label == "td3" else Run()

    report = content(ALGORITHMS, range(2), look)
    failed = report.cells[1]
    assert failed.success.value is None
    assert failed.counts == {"done": 0, "running": 0, "failed": 2, "pending": 0}
    run, _ = report.provenance.unfinished
    described = ("td3", 0, "failed", "ValueError: no way")
    assert (run.label, run.seed, run.status, run.reason) == described
    assert report.missing == ["Runs done: 2 of 4; 2 failed.", "No run is done of td3."]
    assert report.pairs == []


def test_a_run_without_a_final_rate_is_left_out_with_a_warning():
    blank = Run(columns={"success_rate": np.nan})
    report = content({"sac": {}}, look=by_seed(Run(0.6), blank, Run(0.6)))
    assert (report.cells[0].success.value, report.cells[0].success.n) == (pytest.approx(0.6), 2)
    assert any("no final success rate" in line for line in report.warnings)
    (headline,) = report_tables.headline_table(report)
    assert headline.columns[1].write(headline.rows[0]) == "2 of 3"  # what the mean is over
    assert json.loads(json.dumps(report.plain(), allow_nan=False))["cells"][0]["success"]["n"] == 2


def test_runs_of_different_lengths_have_curves_as_far_as_they_go():
    looks = {"short": Run(), "long": Run(curve=[0.8] * 8)}
    cells = {"short": {}, "long": {"total_timesteps": 800}}
    short, long = content(cells, range(2), lambda label, _: looks[label]).cells
    assert (short.curve.step[-1], long.curve.step[-1]) == (400, 800)


def test_time_to_90_percent_is_unknown_where_it_was_not_held():
    runs = by_seed(Run(curve=[1 / 3, 1.0, 1.0, 1.0]), Run(curve=[0.0, 1.0, 1 / 3, 1.0]))
    (cell,) = content({"sac": {}}, [0, 1], runs).cells
    times = [(seed.steps_to_90, seed.reached_90) for seed in cell.seeds]
    assert times == [(200, True), (None, False)]
    assert (cell.n_reached_90, cell.n_timed, cell.steps_to_90) == (1, 2, 200)
    assert cell.cpu_s_to_90 == 150.0
    assert cell.seeds[0].area == pytest.approx((2 / 3 + 1 + 1) / 3)
    assert cell.area.low < cell.area.value < cell.area.high
    (perfect,) = content({"sac": {}}, [0, 1], by_seed(*[Run(curve=[1.0] * 4)] * 2)).cells
    assert perfect.area == Interval(1.0, n=2)


def test_fewer_than_three_evaluations_say_nothing_of_the_time_to_90_percent():
    (cell,) = content({"sac": {}}, [0], by_seed(Run(curve=[0.5, 1.0]))).cells
    (seed,) = cell.seeds
    assert (seed.reached_90, seed.steps_to_90, seed.area) == (None, None, 0.75)
    assert (cell.n_timed, cell.steps_to_90) == (0, None)


def test_a_median_time_needs_half_of_the_seeds():
    held = Run(curve=[0.0, 1.0, 1.0, 1.0, 1.0])
    later = Run(curve=[0.0, 0.0, 1.0, 1.0, 1.0])
    never = Run(curve=[0.0] * 5)
    (cell,) = content({"sac": {}}, range(4), by_seed(never, later, held, never)).cells
    assert cell.steps_to_90 == 240
    (cell,) = content({"sac": {}}, range(3), by_seed(never, held, never)).cells
    assert (cell.n_reached_90, cell.steps_to_90, cell.cpu_s_to_90) == (1, None, None)


def test_a_cpu_time_that_is_not_known_leaves_no_median():
    frames = results({"sac": {}}, range(3), lambda *_: Run(curve=[1.0] * 4))
    is_first = frames.curves["run_id"] == "one-sac-0"
    curves = frames.curves.assign(cpu_s=frames.curves["cpu_s"].mask(is_first))
    (cell,) = build_report(replace(frames, curves=curves), ["one"]).cells
    assert (cell.n_reached_90, cell.steps_to_90, cell.cpu_s_to_90) == (3, 100, None)


def test_unfinished_runs_are_missing_and_quick_shows_their_curves():
    interrupted = Run(status="interrupted", curve=(0, 0.5))
    look = by_seed(Run(), interrupted, interrupted)
    report = content({"sac": {}}, look=look)
    assert report.missing == ["Runs done: 1 of 3; 2 interrupted or not started."]
    assert report.cells[0].curve.n == [1, 1, 1, 1]
    curve = content({"sac": {}}, look=look, quick=True).cells[0].curve
    assert [seed for seed, _, _ in curve.seeds] == [0, 1, 2]
    assert curve.n == [1, 3, 1, 3]


def test_without_a_finished_run_only_a_quick_report_is_made():
    with pytest.raises(RunNotFoundError, match="2 runs, none is done; report=quick"):
        content({"sac": {}}, range(2), by_seed(*[Run(status="interrupted")] * 2))
    report = content({"sac": {}}, [0], by_seed(Run(status="interrupted")), quick=True)
    assert (report.cells[0].success.value, report.claims) == (None, [])
    assert report.cells[0].curve is not None


def test_a_her_ablation_has_main_effects_without_its_control():
    rates = {"future1": 0.4, "future4": 0.8, "final1": 0.2, "final4": 0.6, "replay": 0.2}
    cells = {**crossed(), "replay": REPLAY}
    report = content(cells, range(2), lambda label, _: Run(success=rates[label]))
    buffers, goals = (
        {level.level: round(level.effect.value, 6) for level in effect.levels}
        for effect in report.effects
    )
    assert (buffers, goals) == ({"her_future": 0.6, "her_final": 0.4}, {1: 0.3, 4: 0.7})
    assert report.notes == [
        "Left out of the main effects, since they lack a value of some factor: replay."
    ]
    assert report.claims[0].startswith("n_sampled_goal: ") and "+40.0 points" in report.claims[0]


def factorial(n_seeds=3, her=0.9):
    """A report on twelve cells: replay and HER, three algorithms, two values of gamma. Replay never
    succeeds.
    """
    cells = {}
    rates = {}
    for algorithm, gamma in product(("sac", "td3", "ddpg"), (0.9, 0.95)):
        keys = {"algorithm.name": algorithm, "algorithm.gamma": gamma}
        cells[f"her {algorithm} {gamma}"] = keys
        cells[f"replay {algorithm} {gamma}"] = {**keys, **REPLAY}
        rates |= {f"her {algorithm} {gamma}": her, f"replay {algorithm} {gamma}": 0.0}
    rates["her sac 0.95"] += 0.1
    return results(cells, range(n_seeds), lambda label, seed: Run(success=rates[label]))


def test_a_factorial_report_begins_with_what_each_factor_does_the_largest_first():
    report = build_report(factorial(), ["one"])
    by_size = ["buffer", "algorithm", "gamma"]
    buffer, *_ = report.claims
    assert [claim.partition(":")[0] for claim in report.claims[:3]] == by_size
    assert buffer.startswith("buffer: her_future (91.7 % [")
    assert ") minus replay (0.0 % [" in buffer
    assert "averaged over other factors: +91.7 points [" in buffer
    assert buffer.endswith("p ≤ 0.0001.")  # 2 of 20 ** 6 assignments
    best = "“sac, her_future, gamma=0.95” has the highest final success: 100.0 %"
    assert report.claims[3].startswith(best)
    readable = [content for content in section_contents(report) if content.readable_tables]
    assert readable[0].id == "factors"
    factors, levels = readable[0].readable_tables
    assert [factors.columns[0].write(row) for row in factors.rows] == by_size
    assert factors.columns[3].write(factors.rows[0]).startswith("+91.7 [")
    assert factors.columns[4].write(factors.rows[0]) == "≤ 0.0001"
    assert len(levels.rows) == 7
    assert report.drawn_pairs == ()
    assert any("No figure shows the 66 pairs" in note for note in report.notes)


def matched(report):
    return {(report.labels[pair.a], report.labels[pair.b]) for pair in report.pairs}


def test_factors_of_cells_with_one_seed_have_too_few():
    buffer, *_ = build_report(factorial(1), ["one"]).claims
    assert buffer.startswith("buffer: too few seeds; her_future (91.7 %)")


def test_a_contrast_compares_matched_cells():
    report = build_report(factorial(4), ["one"], contrast="buffer:her_future-replay")
    others = product(("sac", "td3", "ddpg"), (0.9, 0.95))
    assert matched(report) == {
        (f"{name}, her_future, gamma={gamma}", f"{name}, replay, gamma={gamma}")
        for name, gamma in others
    }
    assert "6 declared contrasts." in report.family
    assert report.drawn_pairs == report.pairs
    difference = report.pairs[0].difference
    assert difference.p_corrected == pytest.approx(6 * difference.p)


def test_a_control_is_matched_in_the_factors_that_it_has():
    report = content({**crossed(), "replay": REPLAY}, contrast="buffer:replay-her_final")
    assert matched(report) == {("replay", f"her_final, n_sampled_goal={n}") for n in (1, 4)}


def test_levels_of_a_contrast_may_be_numbers_with_hyphens():
    cells = {str(rate): {"algorithm.learning_rate": rate} for rate in (1e-3, 1e-4, 1e-5)}
    report = content(cells, contrast="learning_rate:1e-3-1e-5")
    assert matched(report) == {("learning_rate=0.001", "learning_rate=1e-05")}


@pytest.mark.parametrize(
    ("contrast", "message"),
    [
        ("bufer:replay-x", "no cell has 'bufer=replay'; did you mean 'buffer=replay'?"),
        ("buffer:her_futur-x", "no cell has 'buffer=her_futur'; did you mean 'buffer=her_future'?"),
        ("gamma:0.95-0.8", "no cell has 'gamma=0.8'; did you mean 'gamma=0.9'?"),
        ("gamma:0.9-0.90", "no two of these cells differ in gamma alone"),
    ],
)
def test_an_unknown_factor_or_level_of_a_contrast_is_a_sentence(contrast, message):
    with pytest.raises(ConfigError) as error:
        build_report(factorial(1), ["one"], contrast=contrast)
    assert str(error.value) == f"contrast={contrast}: {message}"


@pytest.mark.parametrize(
    ("n_evaluations", "sentences"),
    [
        (
            1,
            [
                "There are no learning curves and times to 90 %: "
                "no run was evaluated more than once. "
            ],
        ),
        (2, ["There are no times to 90 %: no run was evaluated more than twice. "]),
        (3, []),
    ],
)
def test_a_report_says_why_it_has_no_curves(n_evaluations, sentences):
    report = content(ALGORITHMS, look=lambda *_: Run(curve=[0.8] * n_evaluations))
    (curves,) = (part for part in section_contents(report) if part.id == "curves")
    remedy = "A smaller evaluation.every_n_steps evaluates runs more often."
    assert curves.text == [f"{sentence}{remedy}" for sentence in sentences]


@pytest.mark.parametrize(
    ("cells", "crossed_factors"),
    [
        (GOALS, ["buffer.n_sampled_goal"]),
        ({n: GOALS[n] for n in ("1", "2")}, []),  # a pair says the same
        (ALGORITHMS, []),
        # drawn from a range
        ({str(n): {"algorithm.gamma": 0.9 + n / 1000} for n in range(20)}, []),
    ],
)
def test_a_series_of_numbers_has_main_effects_and_a_list_has_none(cells, crossed_factors):
    assert [effect.factor for effect in content(cells, [0, 1]).effects] == crossed_factors


def test_many_cells_are_compared_with_the_best_one_and_the_best_are_shown():
    cells = {str(i): {"algorithm.gamma": 0.5 + i / 100} for i in range(40)}
    report = content(cells, [0], lambda label, seed: Run(success=int(label) % 3 / 2))
    assert (len(report.cells), len(report.shown), len(report.pairs)) == (40, 12, 39)
    assert all(cell.success.value == 1.0 for cell in report.shown_cells)
    assert "chosen by its result" in report.family


def declaring(*contrasts, n=20):
    """Cells with more success the larger their gamma, whose file declares contrasts."""
    return {
        str(i): {"algorithm.gamma": 0.5 + i / 100, "contrasts": str([*contrasts])} for i in range(n)
    }


def compared(report):
    return [
        tuple(report.labels[side].partition("gamma=0.")[2] for side in (p.a, p.b))
        for p in report.pairs
    ]


def rising(label, seed):
    return Run(success=int(label) / 20)


def test_declared_contrasts_are_the_family_the_findings_and_in_figures():
    cells = declaring(["gamma=0.5", "gamma=0.51"], ["gamma=0.52", "gamma=0.5"])
    report = content(cells, range(4), rising)
    assert compared(report) == [("5", "51"), ("52", "5")]
    assert "2 declared contrasts." in report.family
    assert report.shown == [f"c{n}" for n in (0, 1, 2, *range(8, 20))]
    assert sum("gamma=0.52 is" in claim and "gamma=0.5 (" in claim for claim in report.claims) == 1
    assert not [warning for warning in report.warnings if "contrast" in warning]
    assert len(content(cells, [0, 1], rising, baseline="gamma=0.53").pairs) == 19


def test_a_contrast_counts_once_and_not_of_a_cell_with_itself():
    report = content(
        declaring(["gamma=0.5", "gamma=0.51"], ["gamma=0.51", "gamma=0.5"], ["gamma=0.5"] * 2),
        [0],
        rising,
    )
    assert compared(report) == [("5", "51")]


def test_a_contrast_that_is_left_out_is_warned_of():
    cells = declaring(
        ["gamma=0.5", "gamma=0.9"], ["gamma=0.5", "gamma=0.51"], ["gamma=0.5", "gamma=0.53"], n=4
    )
    report = content(cells, [0], rising, cells=["gamma=0.5,0.53"])
    assert compared(report) == [("5", "53")]
    (warning,) = (warning for warning in report.warnings if "contrast" in warning)
    assert warning == (
        "2 of 3 contrasts are not tested, since one of their cells is not selected or has no "
        "finished run: gamma=0.5 minus gamma=0.9 and gamma=0.5 minus gamma=0.51. p is corrected "
        "for the other contrasts only."
    )
    looks = {"1": Run(status="failed")}
    unfinished = content(cells, [0], lambda label, seed: looks.get(label, rising(label, seed)))
    assert [text for text in unfinished.warnings if "contrast" in text] == [warning]


@pytest.mark.parametrize("text", ["[1]", "[['a']]", "[['a', 'b'", "x", "__import__('os')"])
def test_contrasts_that_cannot_be_read_are_warned_of(text):
    cells = {"a": {"contrasts": text}, "b": {"algorithm.gamma": 0.5, "contrasts": text}}
    report = content(cells)
    assert len(report.pairs) == 1
    assert "one: its contrasts can't be read." in report.warnings


def test_contrasts_name_cells_as_a_report_on_their_experiment_does():
    both = together(
        results(declaring(["gamma=0.5", "gamma=0.51"], n=2), [0, 1]),
        results({"c": {}}, [0, 1], experiment="other"),
    )
    assert [len({p.a, p.b}) for p in build_report(both, ["one", "other"]).pairs] == [2]


def test_a_report_in_between_has_no_main_effects_while_a_cell_has_no_result():
    looks = {"final4": Run(status="running")}
    report = content(crossed(), [0], lambda label, _: looks.get(label, Run()), quick=True)
    assert (len(report.cells), report.effects) == (4, [])


def chosen(groups, *asked):
    return {cell.label for cell in choose_cells(groups, asked)}


def test_cells_are_chosen_by_label_pattern_and_config():
    groups = group_runs(results(crossed(), [0]).runs)
    final = {"her_final, n_sampled_goal=1", "her_final, n_sampled_goal=4"}
    future = {"her_future, n_sampled_goal=1", "her_future, n_sampled_goal=4"}
    four = {"her_final, n_sampled_goal=4", "her_future, n_sampled_goal=4"}
    assert chosen(groups, "her_final, n_sampled_goal=4") == final & four
    assert chosen(groups, "her_final", "buffer.n_sampled_goal=4") == final & four
    assert chosen(groups, "her_fu*") == future
    assert chosen(groups, "buffer=her_final,her_future", "n_sampled_goal=4.0") == four
    report = content(crossed(), [0], cells=["her_final"])
    assert [cell.label for cell in report.cells] == ["n_sampled_goal=1", "n_sampled_goal=4"]
    assert set(report.provenance.left_out) == future


def test_values_of_a_config_may_be_written_otherwise():
    other = {"algorithm.net_arch": "[16, 16]", "algorithm.gamma": 0.002}
    groups = group_runs(results({"a": other, "b": {}}, [0]).runs)
    assert chosen(groups, "gamma=2e-3") == {groups[0].label}
    assert chosen(groups, "algorithm.net_arch=[16,16]") == {groups[0].label}


@pytest.mark.parametrize(
    ("asked", "parts"),
    [
        ("her_finale", "'her_finale'"),
        ("bufer=her_final", "did you mean 'buffer=her_final'"),
        ("seed=0", "no cell has 'seed=0'"),
    ],
)
def test_an_unknown_cell_is_an_error_that_names_it(asked, parts):
    groups = group_runs(results({"a": {"buffer.name": "her_final"}, "b": {}}, [0]).runs)
    with pytest.raises(ConfigError, match=parts):
        choose_cells(groups, [asked])


def test_an_ambiguous_baseline_is_looked_up_among_the_chosen_cells():
    sparse = {"env.name": "parking_sparse"}
    cells = {"her": {}, "replay": REPLAY, "sparse": sparse, "sparse-replay": {**sparse, **REPLAY}}
    with pytest.raises(ConfigError, match=r"baseline=replay: 2 cells fit"):
        content(cells, baseline="replay")
    report = content(cells, cells=["env=parking_sparse"], baseline="replay")
    names = {cell.id: cell.name for cell in report.cells}
    assert names[report.baseline] == "parking_sparse-sparse-replay"
    for chosen in (["env=parking,parking_sparse"], ["her_future*"]):
        with pytest.raises(ConfigError, match="2 cells fit"):
            content(cells, cells=chosen, baseline="replay")


def test_a_baseline_without_a_finished_run_is_refused_and_a_quick_report_compares_without():
    def look(label, seed):
        return Run(status="failed", error="x") if label == "td3" else Run()

    cells = {**ALGORITHMS, "ddpg": {"algorithm.name": "ddpg"}}
    with pytest.raises(RunNotFoundError, match="baseline=td3"):
        content(cells, look=look, baseline="td3")
    report = content(cells, look=look, baseline="td3", quick=True)
    assert (report.reference, len(report.pairs)) == (None, 1)


def test_of_two_runs_with_the_same_seed_the_one_that_is_done_counts():
    looks = [Run(columns={"seed": 0}), Run(0.2, status="failed", columns={"seed": 0})]
    report = content({"sac": {}}, [0, 1], by_seed(*looks))
    assert [seed.success for seed in report.cells[0].seeds] == [0.8]


def test_levels_that_do_not_differ_are_said_to_be_indistinguishable():
    rng = np.random.default_rng(5)
    rates = {(label, seed): rng.choice([0.4, 0.6, 0.8]) for label in crossed() for seed in range(4)}
    report = content(crossed(), range(4), lambda label, seed: Run(success=rates[label, seed]))
    claims = report.claims
    assert sum(": levels are indistinguishable; " in claim for claim in claims) == 2
    assert not any("is better than" in claim for claim in claims)


def test_levels_are_compared_only_where_the_crossing_is_complete():
    cells = crossed(goals=(1, 2, 4))
    runs = by_seed(Run(0.2), Run(0.4), Run(0.6))
    assert len(content(cells, look=runs).effects) == 2
    del cells["final4"]
    report = content(cells, look=runs)
    assert report.effects == []


def test_a_level_without_any_result_is_left_out_of_the_main_effects():
    looks = {f"{name}4": Run(status="running") for name in ("future", "final")}
    cells = crossed(goals=(1, 2, 4))
    report = content(cells, [0, 1], lambda label, _: looks.get(label, Run()), quick=True)
    levels = {effect.factor: [level.level for level in effect.levels] for effect in report.effects}
    assert levels["buffer.n_sampled_goal"] == [1, 2]


def test_labels_name_the_experiment_if_there_are_several():
    parts = [results(ALGORITHMS, [0], experiment=name) for name in ("one", "two")]
    report = build_report(together(*parts), ["one", "two"])
    assert [cell.label for cell in report.cells] == ["one, sac", "one, td3", "two, sac", "two, td3"]
    some = build_report(together(*parts), ["one", "two"], cells=["one"])
    assert [cell.experiment for cell in some.cells] == ["one", "one"]
    assert sorted(some.provenance.left_out) == ["two, sac", "two, td3"]


def test_problems_of_results_are_warnings_and_the_first_few_are_named():
    frames = replace(results({"sac": {}}), problems=tuple(f"problem {n}" for n in range(7)))
    report = build_report(frames, ["one"])
    problems = [line for line in report.warnings if line.startswith("problem")]
    assert problems == [f"problem {n}" for n in range(5)]
    assert report.warnings[-1] == "Problems of stored results that are not named here: 2."


def test_a_metric_of_a_user_is_a_column_and_empty_where_a_cell_lacks_it():
    own = {"centred_rate": 0.25, "jerk_mean": 2.5}
    looks = {"sac": Run(columns=own), "td3": Run()}
    report = content(ALGORITHMS, look=lambda label, seed: looks[label])

    sac, td3 = report.cells
    assert (sac.metrics["centred_rate"].value, sac.metrics["jerk_mean"].value) == (0.25, 2.5)
    assert sac.metrics["centred_rate"].high > 0.25  # an interval, as of each rate
    assert "centred_rate" not in td3.metrics
    assert report.plain()["cells"][0]["seeds"][0]["jerk_mean"] == 2.5

    (table,) = report_tables.headline_table(report)
    texts = {column.title: [column.write(row) for row in table.rows] for column in table.columns}
    assert texts["centred (%)"][0].startswith("25.0 [")
    assert texts["centred (%)"][1] == ""
    titles = list(texts)
    assert titles.index("centred (%)") == titles.index("Timeout (%)") - 1

    (table,) = report_tables.means_table(report)
    jerk = next(column for column in table.columns if column.title == "jerk")
    assert [jerk.write(row) for row in table.rows] == ["2.50", ""]
