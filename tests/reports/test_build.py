"""Tests of report data, built from the results in a store."""

import math
import re
import shutil
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.stats
from support.runs import in_memory
from support.store_factory import Look, compose, make_store

from parking_exp.errors import ConfigError, RunNotFoundError
from parking_exp.reports.build import Question, build
from parking_exp.reports.curves import RunEvaluations
from parking_exp.reports.selection import choose, group, one_cell
from parking_exp.results.frames import load
from parking_exp.statistics import steps_to

ENDS = {"sac": [0.8, 1.0, 0.8, 1.0, 1.0], "td3": [0.4, 0.2, 0.4, 0.6, 0.4]}
made = make_store
ALGORITHMS = {name: [f"algorithm={name}"] for name in ENDS}


def content(output_dir, experiment="one", **changes):
    results = load(experiment, output_dir=output_dir)
    return build(results, Question(experiments=[experiment], **changes))


@pytest.fixture(scope="module")
def two(empty):
    """Two algorithms with five seeds each."""
    with in_memory() as folder:
        shutil.copy(empty / "mlflow.db", folder)
        output_dir = Path(folder)
        made(output_dir, "one", ALGORITHMS, range(5), lambda label, seed: Look(success=ENDS[label][seed], crash=0))
        yield output_dir


def test_the_headline_is_the_mean_over_seeds_of_the_final_rate(two):
    sac, td3 = content(two).cells
    assert (sac.label, td3.label) == ("sac", "td3")
    assert sac.success.value == pytest.approx(0.92)
    assert td3.success.value == pytest.approx(0.4)
    assert [seed.success for seed in sac.seeds] == ENDS["sac"]
    assert sac.timeout.value == pytest.approx(0.08)
    assert (sac.reaching_90.k, sac.reaching_90.n) == (3, 5)
    assert (sac.success.n, sac.counts["done"]) == (5, 5)
    assert sac.seeds[0].n_scenes == 5
    assert sac.success.low < 0.92 < sac.success.high


def test_pairs_are_welchs_test_with_holms_correction_and_a_verdict(two):
    (pair,) = content(two).pairs
    test = scipy.stats.ttest_ind(ENDS["sac"], ENDS["td3"], equal_var=False)
    assert pair.difference.value == pytest.approx(0.52)
    assert pair.p == pytest.approx(test.pvalue)
    assert pair.p_holm == pytest.approx(test.pvalue)  # a family of one
    assert pair.improvement.value == 1.0
    assert pair.verdict == "a"


def test_with_a_baseline_the_family_is_all_others_against_it(output_dir):
    cells = {str(n): [f"buffer.n_sampled_goal={n}"] for n in (1, 2, 4)}
    made(output_dir, "one", cells, range(3), lambda label, seed: Look(success=int(label) / 5 + (0.2 if seed else 0)))
    found = content(output_dir, baseline="n_sampled_goal=2")
    labels = {cell.id: cell.label for cell in found.cells}
    assert {(labels[pair.a], labels[pair.b]) for pair in found.pairs} == {
        ("n_sampled_goal=1", "n_sampled_goal=2"),
        ("n_sampled_goal=4", "n_sampled_goal=2"),
    }
    assert "2 cells against the baseline" in found.family
    p = sorted(pair.p for pair in found.pairs)
    assert sorted(pair.p_holm for pair in found.pairs) == pytest.approx([min(2 * p[0], 1), max(2 * p[0], p[1])])
    assert len(content(output_dir).pairs) == 3


def test_sentences_say_which_is_better_by_how_much_and_how_sure(two):
    found = content(two)
    assert found.claims[0].startswith("sac has the highest final success: 92.0 % [")
    assert found.claims[0].endswith("of the scenes, mean of 5 seeds.")
    assert found.claims[1].startswith("sac is better than td3 (+52.0 points [+33.")
    assert "p < 0.001" in found.claims[1]
    assert "Seeds that end at 90 % or above: sac 3 of 5 [23, 88 %]; td3 0 of 5 [0, 43 %]." in found.claims


def test_what_can_not_be_told_apart_is_said_to_be_so(output_dir):
    ends = {"sac": [0.8, 1.0, 0.6], "td3": [0.8, 0.8, 0.6]}
    made(output_dir, "one", ALGORITHMS, range(3), lambda label, seed: Look(success=ends[label][seed]))
    found = content(output_dir)
    assert found.pairs[0].verdict == "same"
    assert any(claim.startswith("sac can't be told apart from td3 (+6.7 points [") for claim in found.claims)
    assert not any("is better than" in claim for claim in found.claims)


def test_fewer_than_ten_seeds_are_exploratory(output_dir):
    made(output_dir, "one", {"sac": []}, range(10))
    assert not content(output_dir).exploratory
    made(output_dir, "two", {"sac": []}, range(9))
    found = content(output_dir, "two")
    assert found.exploratory
    assert "Exploratory: the cell has fewer than 10 finished seeds (the fewest: 9)." in found.warnings


@pytest.mark.parametrize(
    ("overrides", "warning"),
    [
        (["total_timesteps=800"], "Budgets are mixed: cells were trained for 400 and 800 env steps."),
        (["evaluation.final_n_scenes=8"], "Scene sets are mixed: final models were evaluated on 5 and 8 scenes."),
        (["evaluation.first_scene=100"], "Scene sets are mixed: they begin at scenes 0 and 100."),
        (["env=parking_sparse"], "Tasks are mixed: cells belong to the envs parking and parking_sparse; "
                                 "their rates are not of the same scenes."),
    ],
)  # fmt: skip
def test_what_is_mixed_is_warned_of(output_dir, overrides, warning):
    made(output_dir, "one", {"plain": [], "other": overrides}, range(2))
    assert warning in content(output_dir).warnings


def test_versions_commits_and_machines_that_are_mixed_are_warned_of(output_dir):
    tags = [
        {"version.highway-env": "1.12.1"},
        {"version.highway-env": "1.11.0", "cpu": "other", "git_commit": "b" * 40},
    ]
    made(output_dir, "one", {"sac": []}, range(2), lambda label, seed: Look(tags=tags[seed]))
    found = content(output_dir)
    assert any(line.startswith("Versions are mixed: highway-env 1.1") for line in found.warnings)
    assert any(line.startswith("Machines are mixed") for line in found.warnings)
    assert found.provenance.versions["highway-env"] == {"1.12.1": 1, "1.11.0": 1}


def test_nothing_is_warned_of_where_nothing_is_wrong(output_dir):
    ends = np.random.default_rng(0).choice([0.4, 0.6, 0.8], 10)
    clean = {"git_dirty": "false", "git_commit": "a" * 40}
    made(
        output_dir,
        "one",
        {"sac": []},
        range(10),
        lambda label, seed: Look(success=ends[seed], tags=clean),
    )
    assert content(output_dir).warnings == []


def test_one_run_has_a_rate_with_wilsons_interval_and_none_over_seeds(output_dir):
    made(output_dir, "one", {"sac": []}, [0], lambda label, seed: Look(success=0.8))
    found = content(output_dir)
    (cell,) = found.cells
    assert (cell.success.value, cell.success.low, cell.success.high, cell.success.method) == (0.8, None, None, "none")
    assert (cell.seeds[0].low, cell.seeds[0].high) == pytest.approx((0.3755, 0.9638), abs=1e-4)  # Wilson's, 4 of 5
    assert (found.design, found.pairs, cell.label) == ("single", [], "sac, her_future")
    assert found.claims[0] == "“sac, her_future” succeeds in 80.0 % of the scenes, one seed."


def test_seeds_that_are_all_perfect_leave_room_below(output_dir):
    made(output_dir, "one", ALGORITHMS, range(3), lambda label, seed: Look(success=1.0, crash=0.0))
    found = content(output_dir)
    for cell in found.cells:
        assert cell.success.value == 1.0
        assert cell.success.low == pytest.approx(0.025 ** (1 / 3))  # Markov's bound
        assert cell.success.high == 1.0
    assert found.pairs[0].verdict == "same"
    assert found.pairs[0].improvement.value == 0.5


def test_a_cell_with_only_failed_runs_has_no_numbers_and_its_reasons(output_dir):
    def look(label, seed):
        return Look(status="failed", error="ValueError: no way") if label == "td3" else Look()

    make_store(output_dir, "one", ALGORITHMS, range(2), look)
    found = content(output_dir)
    failed = found.cells[1]
    assert failed.success.value is None
    assert failed.counts == {"done": 0, "running": 0, "failed": 2, "pending": 0}
    assert [(run.label, run.seed, run.status, run.reason) for run in found.provenance.unfinished] == [
        ("td3", 0, "failed", "ValueError: no way"),
        ("td3", 1, "failed", "ValueError: no way"),
    ]
    assert found.missing == ["2 of 4 runs are done: 2 failed.", "No run is done of td3."]
    assert found.pairs == []


def test_metrics_that_are_nan_leave_a_run_out_and_say_so(output_dir):
    def look(label, seed):
        return Look(success=0.6, nan=["final/success_rate", "eval/success_rate"] if seed == 1 else [])

    made(output_dir, "one", {"sac": []}, range(3), look)
    found = content(output_dir)
    assert (found.cells[0].success.value, found.cells[0].success.n) == (pytest.approx(0.6), 2)
    assert "“sac, her_future”: a run was finished without a final success rate, and left out." in found.warnings
    assert not any(math.isnan(value) for value in numbers(found.plain()))


@pytest.mark.parametrize(
    ("key", "value"),
    [("env.vehicles_count", "many"), ("env.vehicles_count", "99"), ("buffer.n_sampled_goal", "9" * 5000), ("total_timesteps", "-inf"), ("evaluation.final_n_scenes", "9" * 20)],
)  # fmt: skip
def test_a_config_that_is_nonsense_breaks_no_report(output_dir, key, value):
    runs = made(output_dir, "one", {"sac": [], "td3": ["algorithm=td3"]}, range(2))
    with sqlite3.connect(output_dir / "mlflow.db") as database:
        database.execute("update params set value=? where key=? and run_uuid=?", (value, key, runs["sac", 0].run_id))
    assert [cell.success.n for cell in content(output_dir).cells] == [2, 2]


def test_a_label_with_commas_reads_as_one_name_in_sentences(output_dir):
    cells = {
        f"{kind} {n}": [f"buffer=her_{kind}", f"buffer.n_sampled_goal={n}"]
        for kind in ("future", "final")
        for n in (1, 4)
    }
    made(
        output_dir, "one", cells, range(3), lambda label, _: Look(success=0.8 if label == "future 1" else 0.4, crash=0)
    )
    found = content(output_dir)
    names = {f"her_{kind}, n_sampled_goal={n}" for kind in ("future", "final") for n in (1, 4)}
    assert {cell.label for cell in found.cells} == names
    assert found.claims[0].startswith("“her_future, n_sampled_goal=1” has the highest final success: 80.0 % [")
    assert found.claims[1].startswith(
        "“her_future, n_sampled_goal=1” can't be told apart from “her_final, n_sampled_goal=1” (+40.0 points"
    )
    for sentence in (*found.claims, *found.warnings, *found.missing, *found.notes):
        assert not any(name in re.sub("“[^”]*”", "", sentence) for name in names), sentence
    assert any(names <= set(re.findall("“([^”]*)”", sentence)) for sentence in found.claims)


def test_runs_of_different_lengths_have_curves_as_far_as_they_go(output_dir):
    made(output_dir, "one", {"short": [], "long": ["total_timesteps=800"]}, range(2), lambda *_: Look(success=0.8))
    short, long = content(output_dir).cells
    assert (short.curve.step[-1], long.curve.step[-1]) == (400, 800)
    assert short.survival.horizon == long.survival.horizon == 200  # three evaluations from 200 on end at 400


def test_time_to_90_percent_is_censored_where_it_was_not_held(output_dir):
    curves = {0: [1 / 3, 1.0, 1.0, 1.0], 1: [0.0, 1.0, 1 / 3, 1.0]}  # of three scenes
    made(output_dir, "one", {"sac": []}, [0, 1], lambda label, seed: Look(curve=curves[seed]))
    (cell,) = content(output_dir).cells
    assert [(seed.steps_to_90, seed.reached_90) for seed in cell.seeds] == [(200, True), (200, False)]
    assert cell.survival.censored == [200]
    assert (cell.survival.k, cell.survival.n, cell.survival.median) == (1, 2, 200)
    assert cell.seeds[0].area == pytest.approx((2 / 3 + 1 + 1) / 3)


def test_unfinished_runs_are_missing_and_quick_shows_their_curves(output_dir):
    def look(label, seed):
        return Look(status="done" if seed == 0 else "interrupted", curve=[0, 1 / 3, 2 / 3, 1])

    made(output_dir, "one", {"sac": []}, range(3), look)
    found = content(output_dir)
    assert found.missing == ["1 of 3 runs are done: 2 cut off or not begun."]
    assert [seed for seed, _, _ in found.cells[0].curve.seeds] == [0]
    quick = content(output_dir, quick=True)
    assert [seed for seed, _, _ in quick.cells[0].curve.seeds] == [0, 1, 2]
    assert quick.cells[0].curve.n == [3, 3, 1, 1]


def test_where_nothing_is_done_quick_still_shows_what_there_is(output_dir):
    made(output_dir, "one", {"sac": []}, range(2), lambda *_: Look(status="interrupted"))
    with pytest.raises(RunNotFoundError, match="of its 2 runs, none is done; report=quick shows what there is so far"):
        content(output_dir)
    found = content(output_dir, quick=True)
    assert found.cells[0].success.value is None
    assert found.cells[0].curve is not None
    assert found.claims == []


def test_runs_that_are_planned_here_and_not_begun_are_missing(output_dir):
    from parking_exp.runs.directory import RunDirectory
    from parking_exp.tracking.mirror import mirror_problem

    runs = make_store(output_dir, "one", {"sac": []}, [0])
    config = runs["sac", 0].config().model_copy(update={"seed": 7})
    directory = RunDirectory(config.run_dir)
    directory.freeze(config, "sac", None)
    assert mirror_problem([directory], directory.tracking_uri) is None
    assert content(output_dir).missing == ["1 of 2 runs are done: 1 cut off or not begun."]


def test_a_her_ablation_has_effects_interactions_and_the_real_share(output_dir):
    cells = {f"{s}{n}": [f"buffer=her_{s}", f"buffer.n_sampled_goal={n}"] for s in ("future", "final") for n in (1, 4)}
    cells["replay"] = ["buffer=replay"]

    def look(label, seed):
        rates = {"future1": 0.4, "future4": 0.8, "final1": 0.2, "final4": 0.6}
        nan = ["buffer/real_share"] if label == "replay" else []
        return Look(success=rates.get(label, 0.2), nan=nan, real_share=0.6 if label == "final4" else 0.3)

    made(output_dir, "one", cells, range(2), look)
    found = content(output_dir)
    assert found.design == "factorial"
    strategy, goals = found.effects
    assert {level.level: round(level.effect.value, 6) for level in strategy.levels} == {
        "her_future": 0.6,
        "her_final": 0.4,
    }
    assert {level.level: round(level.effect.value, 6) for level in goals.levels} == {1: 0.3, 4: 0.7}
    (table,) = found.interactions
    assert (table.row, table.column, table.given) == ("buffer", "buffer.n_sampled_goal", None)
    assert list(table.columns) == [1, 4, None]
    assert found.notes == ["Not part of the main effects, without a value of every factor: replay."]
    assert list(table.rows) == ["her_final", "her_future", "replay"]
    assert table.real_share == [[0.3, 0.6, None], [0.3, 0.3, None], [None, None, 1.0]]
    at = {row: dict(zip(table.columns, means, strict=True)) for row, means in zip(table.rows, table.mean, strict=True)}
    assert at["her_final"][4] == pytest.approx(0.6)
    assert at["replay"] == {1: None, 4: None, None: pytest.approx(0.2)}
    assert max(abs(r) for row in table.residual for r in row if r is not None) == pytest.approx(0, abs=1e-9)


@pytest.mark.slow
def test_a_search_says_what_each_hyperparameter_explains(output_dir):
    rng = np.random.default_rng(1)
    draws = [(float(10 ** -rng.uniform(2, 4)), float(rng.uniform(0.8, 0.99))) for _ in range(12)]
    cells = {
        str(i): [f"algorithm.learning_rate={lr}", f"algorithm.gamma={gamma}"] for i, (lr, gamma) in enumerate(draws)
    }
    order = np.argsort([lr for lr, _ in draws]).argsort()
    made(output_dir, "one", cells, [0], lambda label, seed: Look(success=order[int(label)] // 2 / 5))
    found = content(output_dir)
    assert found.design == "search"
    first, second = found.importance
    assert first.factor == "algorithm.learning_rate"
    assert first.share > 0.9
    assert first.direction > 0.9
    assert second.share < 0.6
    assert any(claim.startswith("learning_rate alone explains 9") for claim in found.claims)


def test_scenes_are_mapped_to_their_goal_slots_and_some_episodes_are_drawn(two):
    sac = content(two).cells[0]
    assert sum(slot.n for slot in sac.slots) == 25
    assert sum(slot.n * slot.timeout for slot in sac.slots) == pytest.approx(2)
    outcomes = [path.outcome for path in sac.paths]
    assert outcomes.count("timeout") == 2
    assert len(sac.failures) == 2
    for path in sac.paths:
        assert len(path.x_m) == len(path.y_m) == len(path.heading_rad) > 1
    assert content(two).cells[0].paths == sac.paths  # the same ones again


@pytest.mark.slow
def test_hundreds_of_cells_are_compared_with_one_and_the_best_are_shown(output_dir):
    base, configs = compose(), {}
    for label in map(str, range(300)):
        arguments = {**base.algorithm.model_extra, "gamma": 0.5 + int(label) / 700}
        algorithm = type(base.algorithm).model_validate({**base.algorithm.model_dump(by_alias=True), **arguments})
        configs[label] = base.model_copy(update={"algorithm": algorithm})
    made(output_dir, "one", configs, [0], lambda label, seed: Look(success=int(label) % 6 / 5))
    found = content(output_dir)
    assert len(found.cells) == 300
    assert len(found.shown) == 12
    assert len(found.pairs) == 299
    assert "chosen by its result" in found.family
    assert "Pictures show the 12 with the highest success of 300 cells; tables have all." in found.notes


def test_cells_are_chosen_by_label_pattern_and_config(output_dir):
    cells = {f"{s}{n}": [f"buffer=her_{s}", f"buffer.n_sampled_goal={n}"] for s in ("future", "final") for n in (1, 4)}
    made(output_dir, "one", cells, [0])
    groups, _ = group(load("one", output_dir=output_dir).runs)

    def labels(*asked):
        return {one.label for one in choose(groups, asked)}

    assert labels("her_final, n_sampled_goal=4") == {"her_final, n_sampled_goal=4"}
    assert labels("her_fu*") == {"her_future, n_sampled_goal=1", "her_future, n_sampled_goal=4"}
    assert labels("her_final", "buffer.n_sampled_goal=4") == {"her_final, n_sampled_goal=4"}
    assert labels("buffer=her_final") == {"her_final, n_sampled_goal=1", "her_final, n_sampled_goal=4"}
    assert labels("buffer=her_final,her_future", "buffer.n_sampled_goal=1") == {
        "her_final, n_sampled_goal=1",
        "her_future, n_sampled_goal=1",
    }
    found = content(output_dir, cells=["her_final"])
    assert [cell.label for cell in found.cells] == ["n_sampled_goal=1", "n_sampled_goal=4"]
    assert sorted(found.provenance.left_out) == ["her_future, n_sampled_goal=1", "her_future, n_sampled_goal=4"]


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ("her_finale", "no cell is called 'her_finale'"),
        ("bufer=her_final", "bufer: neither a key of this command nor of these runs' configs; did you mean 'buffer'?"),
        ("buffer=her_past", "buffer=her_past: no run has that"),
    ],
)
def test_a_cell_that_there_is_not_is_refused_in_a_sentence(output_dir, asked, words):
    made(output_dir, "one", {"a": ["buffer=her_final"], "b": []}, [0])
    groups, _ = group(load("one", output_dir=output_dir).runs)
    with pytest.raises(ConfigError, match=words):
        choose(groups, [asked])
    with pytest.raises(ConfigError):
        one_cell(groups, asked)


def test_a_baseline_has_to_be_one_cell(output_dir):
    made(output_dir, "one", {"a": ["buffer=her_final"], "b": []}, [0])
    groups, _ = group(load("one", output_dir=output_dir).runs)
    with pytest.raises(ConfigError, match=r"baseline=her_\*: 2 cells fit"):
        one_cell(groups, "her_*")


def test_of_baselines_that_fit_the_one_among_the_chosen_cells_is_meant(output_dir):
    buffers = {"her": [], "replay": ["buffer=replay"]}
    tasks = {"parking": [], "parking_sparse": ["env=parking_sparse"]}
    cells = {f"{env}-{name}": [*task, *buffer] for env, task in tasks.items() for name, buffer in buffers.items()}
    made(output_dir, "one", cells, [0, 1])
    with pytest.raises(ConfigError, match=r"baseline=replay: 2 cells fit, 'parking, replay', 'parking_sparse, replay'"):
        content(output_dir, baseline="replay")
    found = content(output_dir, cells=["env=parking_sparse"], baseline="replay")
    for chosen in (["env=parking,parking_sparse"], ["her_future*"]):
        with pytest.raises(ConfigError, match="2 cells fit"):
            content(output_dir, cells=chosen, baseline="replay")
    (baseline,) = (cell for cell in found.cells if cell.id == found.baseline)
    assert baseline.label == "replay"
    assert baseline.name.startswith("parking_sparse-")


def test_of_two_runs_with_the_same_seed_the_one_that_is_done_counts(output_dir):
    made(output_dir, "one", {"sac": []}, [0, 1], lambda label, seed: Look(success=0.2 if seed else 0.8))
    results = load("one", output_dir=output_dir)
    again = results.runs.assign(seed=0)
    again.loc[again["success_rate"] == 0.2, "status"] = "failed"
    found = build(replace(results, runs=again), Question(experiments=["one"]))
    assert [seed.success for seed in found.cells[0].seeds] == [0.8]
    assert "“sac, her_future”: a run was left out, since another one has the same seed." in found.warnings


def numbers(value):
    if isinstance(value, dict):
        return [one for part in value.values() for one in numbers(part)]
    if isinstance(value, list | tuple):
        return [one for part in value for one in numbers(part)]
    return [value] if isinstance(value, float) else []


def test_everything_is_plain_enough_for_json(two):
    import json

    again = json.loads(json.dumps(content(two).plain(), allow_nan=False))
    assert again["cells"][0]["success"]["value"] == pytest.approx(0.92)
    assert isinstance(pd.json_normalize(again["pairs"]), pd.DataFrame)


def test_a_crossing_without_effects_claims_none(output_dir):
    rng = np.random.default_rng(5)
    cells = {f"{s}{n}": [f"buffer=her_{s}", f"buffer.n_sampled_goal={n}"] for s in ("future", "final") for n in (1, 4)}
    rates = {(label, seed): rng.choice([0.4, 0.6, 0.8]) for label in cells for seed in range(4)}
    made(output_dir, "one", cells, range(4), lambda label, seed: Look(success=rates[label, seed]))
    found = content(output_dir)
    said = " ".join(found.claims)
    assert said.count("levels can't be told apart, on average over the other factors") == 2
    assert "add up, as far as can be told (F test, p = " in said
    assert "is better than" not in said


def test_a_single_factor_has_no_others_and_levels_that_tie_are_not_said_to_differ(output_dir):
    cells = {str(n): [f"buffer.n_sampled_goal={n}"] for n in (1, 2, 4)}
    made(
        output_dir,
        "one",
        cells,
        range(3),
        lambda label, seed: Look(success=0.8 if label == "4" else 0.4 + 0.2 * (seed == 0)),
    )
    (claim,) = (claim for claim in content(output_dir).claims if claim.startswith("n_sampled_goal: "))
    assert "other factors" not in claim
    made(output_dir, "two", cells, range(3), lambda *_: Look(success=0.8))
    assert not any(claim.startswith("n_sampled_goal: ") for claim in content(output_dir, "two").claims)


def test_levels_of_an_incomplete_crossing_are_not_compared(output_dir):
    cells = {
        f"{s}{n}": [f"buffer=her_{s}", f"buffer.n_sampled_goal={n}"] for s in ("future", "final") for n in (1, 2, 4)
    }
    del cells["final4"], cells["future1"]
    made(output_dir, "one", cells, range(3), lambda label, seed: Look(success=0.2 * (seed + ("future" in label))))
    found = content(output_dir)
    assert found.effects
    assert not any(effect.complete for effect in found.effects)
    assert "Not all combinations of the factors are there: their levels are means of different cells." in found.claims
    assert not any("on average over the other factors" in claim for claim in found.claims)


def test_a_baseline_without_a_finished_run_is_refused_and_quick_compares_without(output_dir):
    def look(label, seed):
        return Look(status="failed", error="x") if label == "td3" else Look()

    made(output_dir, "one", {**ALGORITHMS, "ddpg": ["algorithm=ddpg"]}, range(2), look)
    with pytest.raises(RunNotFoundError, match=r"baseline=td3: of its 2 runs, none is done"):
        content(output_dir, baseline="td3")
    found = content(output_dir, baseline="td3", quick=True)
    assert found.reference is None
    assert found.family.startswith("Compared were two cells, ")


def test_cells_that_tie_share_the_first_place(output_dir):
    made(output_dir, "one", ALGORITHMS, range(2), lambda label, seed: Look(success=1.0 - 0.2 * seed, crash=0))
    assert content(output_dir).claims[0].startswith("sac and td3 have the same final success, the highest: 90.0 %")


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("evaluation.n_scenes=4", "Scene sets are mixed: evaluations during training were on 3 and 4 scenes."),
        (
            "evaluation.every_n_steps=200",
            "Evaluations are mixed: every 100 and 200 env steps, which changes times to 90 %.",
        ),
    ],
)
def test_evaluations_that_are_mixed_are_warned_of(output_dir, override, words):
    made(output_dir, "one", {"plain": [], "other": [override]}, range(2))
    assert words in content(output_dir).warnings


def test_an_evaluation_without_a_rate_does_not_count_as_holding(two):
    results = load("one", output_dir=two)
    run = results.runs["run_id"][0]
    curve = results.curves[results.curves["run_id"] == run].iloc[:4].assign(success_rate=[0.95, math.nan, 0.95, 0.95])
    course = RunEvaluations.of(replace(results, curves=curve)).curves[run]
    assert steps_to(course.step, course.success) == (course.step[1], False)
    assert course.watched(3) == (course.step[1], course.cpu_s[1])


def test_what_a_sync_cannot_send_is_warned_of(two):
    said = ["The store has not got all of 1 run, e.g. x: no space left on device."]
    found = build(load("one", output_dir=two), Question(["one"]), unsynced=said)
    assert said[0] in found.warnings


def test_cells_of_other_experiments_with_the_same_name_are_left_out_by_name(output_dir):
    for experiment in ("one", "two"):
        made(output_dir, experiment, ALGORITHMS, [0])
    results = load(["one", "two"], output_dir=output_dir)
    found = build(results, Question(experiments=["one", "two"], cells=["one"]))
    assert [cell.experiment for cell in found.cells] == ["one", "one"]
    assert sorted(found.provenance.left_out) == ["two, sac", "two, td3"]


def test_cells_are_narrowed_by_the_end_of_a_key_by_lists_and_by_other_ways_to_write_a_number(output_dir):
    cells = {"a": ["buffer=her_final", "algorithm.net_arch=[16,16]"], "b": ["buffer=her_final", "algorithm.gamma=0.002"],
             "c": ["algorithm.gamma=0.002"]}  # fmt: skip
    made(output_dir, "one", cells, [0])
    groups, _ = group(load("one", output_dir=output_dir).runs)
    assert len(choose(groups, ["gamma=2e-3"])) == 2
    assert len(choose(groups, ["her_final", "gamma=0.002"])) == 1
    assert len(choose(groups, ["algorithm.net_arch=[16,16]"])) == 3
    with pytest.raises(ConfigError, match=r"^seed: neither a key"):
        choose(groups, ["seed=0"])


def test_infinite_values_of_a_config_are_words(two):
    results = load("one", output_dir=two)
    found = build(
        replace(results, runs=results.runs.assign(**{"config.env.x": [math.inf] * 5 + [1.0] * 5})),
        Question(["one"]),
    )
    assert found.provenance.difference["env.x"] == ["inf", 1.0]


def test_the_same_config_in_two_experiments_is_said_to_be_the_same_runs(output_dir):
    for experiment in ("one", "two"):
        made(output_dir, experiment, {"sac": []}, [0])
    found = build(load(["one", "two"], output_dir=output_dir), Question(["one", "two"]))
    assert (
        "one and two have the same config: equal seeds are equal runs, and they are not independent." in found.warnings
    )


def test_a_factor_of_which_one_level_is_done_has_no_difference_yet(output_dir):
    cells = {str(n): [f"buffer.n_sampled_goal={n}"] for n in (1, 2, 4)}
    made(output_dir, "one", cells, range(2), lambda label, seed: Look(status="done" if label == "1" else "interrupted"))
    found = content(output_dir, quick=True)
    (effect,) = found.effects
    assert [level.level for level in effect.levels] == [1]
    assert (effect.largest, effect.p) == (None, None)
    assert not any(claim.startswith("n_sampled_goal: ") for claim in found.claims)


def test_differences_end_where_rates_do(output_dir):
    cells = {str(n): [f"buffer.n_sampled_goal={n}"] for n in (1, 2, 4)}
    made(
        output_dir,
        "one",
        cells,
        range(2),
        lambda label, seed: Look(success=(0.2, 1.0)[seed] if label == "1" else 0.2 * seed),
    )
    found = content(output_dir)
    (effect,) = found.effects
    spans = [effect.largest, *(pair.difference for pair in found.pairs)]
    assert all(-1 <= span.low <= span.value <= span.high <= 1 for span in spans)
    assert (effect.largest.low, effect.largest.high) == (-1, 1)
