"""The parts of a report that a hyperparameter search has, from studies with made-up trials."""

import csv
import json
import re
import subprocess
import sys
from dataclasses import asdict, replace
from statistics import mean

import optuna
import pytest
import scipy.stats
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.trial import TrialState, create_trial
from support import report_factory
from support.searches import settings
from support.store_factory import Look, compose, make_store

from parking_exp.reports.build import Question, build
from parking_exp.reports.figures.export import draw
from parking_exp.reports.render.files import write_tables
from parking_exp.reports.render.markdown import markdown
from parking_exp.reports.render.page import page
from parking_exp.reports.report_data import Factor
from parking_exp.reports.sections import SECTIONS
from parking_exp.reports.tuning import FEWEST_TRIALS, tuning_of, with_search
from parking_exp.reports.tuning_data import Budget
from parking_exp.reports.tuning_findings import claims, retest_text, search_text
from parking_exp.reports.untracked import find_untracked
from parking_exp.results.frames import load
from parking_exp.runs.files import write_json
from parking_exp.statistics import mean_interval
from parking_exp.tuning.study import directions, storage_of
from parking_exp.tuning.trials import rows

SPACE = {
    "algorithm.learning_rate": {"log": [1e-4, 1e-2]},
    "algorithm.gamma": {"one_minus_log": [0.9, 0.99]},
    "buffer": {"choices": ["her_future", "replay"]},
    "buffer.n_sampled_goal": {"int": [1, 8], "when": {"buffer": ["her_future"]}},
}
DISTRIBUTIONS = {
    "algorithm.learning_rate": FloatDistribution(1e-4, 1e-2, log=True),
    "1 - algorithm.gamma": FloatDistribution(0.01, 0.1, log=True),
    "buffer": CategoricalDistribution(['"her_future"', '"replay"']),
    "buffer.n_sampled_goal": IntDistribution(1, 8),
}
OWN = [section for section in SECTIONS if section.id in ("retest", "tuning")]
STATES = {"done": TrialState.COMPLETE, "pruned": TrialState.PRUNED, "failed": TrialState.FAIL}


def trial(*values, state="done", rate=1e-3, gamma=0.95, buffer="her_future", goals=4, **attributes):
    """A trial of a study, with what a worker notes of it."""
    changes = {"algorithm.learning_rate": rate, "algorithm.gamma": gamma, "buffer": buffer}
    parameters = {
        "algorithm.learning_rate": rate,
        "1 - algorithm.gamma": round(1 - gamma, 6),
        "buffer": json.dumps(buffer),
    }
    if buffer == "her_future":
        changes["buffer.n_sampled_goal"] = parameters["buffer.n_sampled_goal"] = goals
    return create_trial(
        state=STATES[state],
        values=list(values) if state == "done" else None,
        params=parameters,
        distributions={name: DISTRIBUTIONS[name] for name in parameters},
        user_attrs={"changes": changes, "env_steps": 800, "cpu_s": 12.5, **attributes},
    )


def tuning(folder, trials, n_trials=None, **changes):
    """What a report has of a search with these trials."""
    search = settings(space=SPACE, **changes)
    study = optuna.create_study(directions=directions(search))
    study.add_trials(trials)
    total = n_trials or len(trials)
    return tuning_of(folder, search, total, rows(study, folder, total), study)


def retested(folder, objective, *trials):
    """Write `retest.json`."""
    items = [
        {"number": number, "label": f"trial {number}: as it stands", "changes": {}, "tuning": tuned, "test": test}
        for number, tuned, test in trials
    ]
    write_json(folder / "retest.json", {"objective": objective, "trials": items})


@pytest.fixture
def folder(tmp_path):
    """The folder of an experiment."""
    path = tmp_path / "smoke"
    path.mkdir()
    return path


@pytest.fixture
def begun(folder):
    """The folder of a search in its own storage: its output directory is beside it."""
    study = optuna.create_study(study_name="smoke", storage=storage_of(folder, None), direction="maximize")
    study.add_trials([trial(0.5), trial(0.25, rate=2e-3)])
    write_search(folder)
    return folder


def write_search(folder, **changes):
    plain = settings(space=SPACE).model_dump(by_alias=True)
    write_json(folder / "search.json", {"overrides": [], "storage": None, "n_trials": 3, "search": plain, **changes})


def report(*experiments):
    return replace(report_factory.report(2, 2), experiments=list(experiments))


def tips(picture):
    return re.findall(r'data-tip="([^"]*)"', picture.svg)


def test_the_best_so_far_is_the_highest_or_the_lowest_value_of_trials_until_then(folder):
    trials = [trial(0.2, 50.0), trial(state="pruned"), trial(0.1, 70.0), trial(0.6, 40.0)]
    found = tuning(folder, [trial(state="failed", reason="no"), *trials], objective=["success_auc", "cost_to_95"])
    assert [one.best for one in found.trials] == [[], [0.2, 50.0], [0.2, 50.0], [0.2, 50.0], [0.6, 40.0]]
    assert [one.values for one in found.trials] == [[], [0.2, 50.0], [], [0.1, 70.0], [0.6, 40.0]]


def test_trials_have_states_and_those_that_have_not_begun_are_pending(folder):
    found = tuning(folder, [trial(0.2), trial(state="pruned"), trial(state="failed", reason="no")], n_trials=5)
    assert [one.state for one in found.trials] == ["done", "pruned", "failed"]
    assert found.trials[2].reason == "no"
    (told, *_) = search_text(replace(report(), tuning=found))
    assert told == (
        "5 trials (sampler tpe, pruner none): 1 done, 1 pruned, 1 failed, 2 pending. "
        "The objective is success_auc, mean over 2 tuning seeds."
    )


def test_parameters_have_the_values_that_were_tried_and_the_scales_of_the_space(folder):
    found = tuning(folder, [trial(0.2, rate=1e-3, gamma=0.98), trial(0.3, rate=1e-4, buffer="replay")])
    assert found.parameters == [
        Factor("algorithm.learning_rate", "learning_rate", [1e-4, 1e-3], numeric=True, log=True),
        Factor("1 - algorithm.gamma", "1 - gamma", [0.02, 0.05], numeric=True, log=True),
        Factor("buffer", "buffer", ["her_future", "replay"], numeric=False),
        Factor("buffer.n_sampled_goal", "n_sampled_goal", [4], numeric=True),
    ]
    assert "buffer.n_sampled_goal" not in found.trials[1].settings


def test_the_budget_counts_what_pruned_trials_took_and_what_they_did_not_take(folder):
    for number, total in ((1, 400), (3, 300)):
        path = folder / f"cell-{number}" / "seed=1001" / "status.json"
        path.parent.mkdir(parents=True)
        write_json(path, {"status": "pruned", "total_timesteps": total})
    found = tuning(
        folder,
        [
            trial(0.5, env_steps=800, runs=["smoke/cell-0/seed=1001", "smoke/cell-0/seed=1002"]),
            trial(state="pruned", env_steps=100, runs=["smoke/cell-1/seed=1001"]),  # of 2 x 400
            trial(state="pruned", env_steps=100, runs=["smoke/cell-1/seed=1001"]),  # the same run again
            trial(state="pruned", env_steps=350, runs=["smoke/cell-3/seed=1001", "smoke/cell-3/seed=1002"]),  # 2 x 300
            trial(state="pruned", env_steps=200, runs=["smoke/gone/seed=1001"]),  # as many as the longest: 800
            trial(state="failed", env_steps=None, runs=["smoke/cell-5/seed=1001"]),
        ],
    )
    assert found.budget == Budget(done=800, pruned=650, n_done=1, n_pruned=3, saved=700 + 250 + 600)
    assert (
        "Pruning saved 1,550 env steps, 52 % of what the trials would have taken: 3 pruned trials took 650 of 2,200."
        in search_text(replace(report(), tuning=found))
    )


def test_nothing_is_said_to_be_saved_where_no_length_is_known_or_nothing_was_pruned(folder):
    unknown = tuning(folder, [trial(state="pruned", env_steps=100)])
    assert unknown.budget == Budget(0, 100, 0, 1, None)
    assert "1 pruned trial took 100 env steps." in search_text(replace(report(), tuning=unknown))
    nothing = tuning(folder, [trial(0.5)])
    assert nothing.budget == Budget(800, 0, 1, 0, 0)
    assert not any("runing" in told for told in search_text(replace(report(), tuning=nothing))[1:])


def test_the_front_has_the_trials_that_none_beats_in_all_objectives(folder):
    values = [(0.5, 60.0), (0.7, 80.0), (0.4, 70.0), (0.7, 90.0), (0.2, 30.0)]
    found = tuning(folder, [trial(*pair) for pair in values], objective=["success_auc", "cost_to_95"])
    assert found.front == [0, 1, 4]
    assert tuning(folder, [trial(0.5)]).front == []


def test_importance_takes_some_trials_that_differ_and_says_so(folder):
    few = tuning(folder, [trial(k / 20) for k in range(FEWEST_TRIALS - 1)])
    assert few.importance == {}
    assert few.notes == ["The importance of parameters is left out: 19 trials are done, and it takes 20."]
    same = tuning(folder, [trial(0.5) for _ in range(FEWEST_TRIALS)])
    assert same.notes == ["The importance of parameters is left out: all trials that are done have the same value."]


def test_importance_finds_the_parameter_that_values_follow_from(folder):
    rates = [10 ** (-4 + k / 20) for k in range(40)]
    trials = [
        trial(k / 40, rate=rates[k], gamma=0.9 + 0.09 * (k * 7 % 40) / 40, buffer=("her_future", "replay")[k % 2])
        for k in range(40)
    ]
    found = tuning(folder, trials)
    assert next(iter(found.importance)) == "algorithm.learning_rate"
    assert found.importance["algorithm.learning_rate"] > 0.5
    assert sum(found.importance.values()) == pytest.approx(1)
    assert found.notes == []


def test_re_runs_have_intervals_and_welchs_for_tuning_minus_test(folder):
    tuned, test = [0.9, 0.8], [0.7, 0.6, 0.8]
    retested(folder, "success_auc", (1, tuned, test), (0, [0.5, 0.4], [0.5, 0.4, 0.6]))
    found = tuning(folder, [trial(0.45), trial(0.85)])
    best = found.retested[0]
    assert (best.number, best.tuning_mean.value, best.test_mean.value) == (1, mean(tuned), pytest.approx(0.7))
    assert (best.test_mean.low, best.test_mean.high) == (mean_interval(test).low, mean_interval(test).high)
    expected = scipy.stats.ttest_ind(tuned, test, equal_var=False).confidence_interval()
    assert best.difference.value == pytest.approx(0.15)
    assert (best.difference.low, best.difference.high) == pytest.approx((expected.low, expected.high))
    assert next(claims(found)).startswith(
        "Of the 2 trials trained again on fresh seeds, “trial 1: as it stands” does best: success_auc 70.0 % ["
    )
    told = retest_text(replace(report(), tuning=found))
    assert told[0].startswith("The best trials and trial 0, the config as it stands, were trained again on 3 seeds")
    assert told[1].startswith("“trial 1: as it stands”: tuning minus test +15.0 points [")


def test_seeds_that_never_hold_95_percent_are_counted_and_no_part_of_a_mean(folder):
    retested(folder, "cost_to_95", (0, [40.0, 50.0], [45.0, 1e5 + 300]), (1, [60.0, 62.0], [61.0, 67.0]))
    found = tuning(folder, [trial(45.0), trial(61.0), trial(0.5e5 + 70)], objective="cost_to_95")
    missed, held = found.retested
    assert (missed.tuning_missed, missed.test_missed) == (0, 1)
    assert (missed.tuning_mean.value, missed.test_mean.value, missed.difference.value) == (45.0, None, None)
    assert (held.tuning_mean.value, held.test_mean.value, held.difference.value) == (61.0, 64.0, -3.0)
    assert [found.objectives[0].missed(one.values[0]) for one in found.trials] == [False, False, True]
    told = retest_text(replace(report(), tuning=found))
    assert told[1:] == [
        "“trial 0: as it stands”: 95 % are never held by 0 of 2 seeds of tuning and 1 of 2 seeds of the test."
    ]


@pytest.mark.parametrize(
    "content",
    [
        {"objective": "success_auc"},
        {"objective": "nonsense", "trials": []},
        {"objective": "success_auc", "trials": [{"number": 0, "label": "x", "tuning": [], "test": [0.5]}]},
        {"objective": "success_auc", "trials": [{"number": 0, "label": "x", "tuning": [2.0], "test": [0.5]}]},
        {"objective": "success_auc", "trials": [{"number": 0, "label": "x", "tuning": None, "test": [0.5]}]},
    ],
)
def test_re_runs_that_can_not_be_read_are_left_out_with_a_sentence(folder, content):
    write_json(folder / "retest.json", content)
    found = tuning(folder, [trial(0.5)])
    assert (found.retested, found.retested_on) == ([], None)
    assert found.notes[-1] == f"The re-runs are left out: {folder / 'retest.json'} can't be read."


def test_everything_goes_into_json_and_back(folder):
    retested(folder, "success_auc", (0, [0.5], [0.5]))  # one seed: no interval
    found = tuning(folder, [trial(0.5, values_by_seed=[[0.4], [0.6]]), trial(state="pruned")])
    plain = replace(report(), tuning=found).plain()
    assert json.loads(json.dumps(plain, allow_nan=False))["tuning"] == asdict(found)


def test_pictures_and_tables_are_there_for_what_there_is(folder, tmp_path):
    retested(folder, "success_auc", (1, [0.9, 0.8], [0.7, 0.6]))
    found = tuning(folder, [trial(0.45), trial(0.85, rate=2e-3, buffer="replay"), trial(state="pruned", env_steps=8)])
    whole = replace(report(), tuning=found)
    pictures = {picture.name: picture for picture in draw(whole, tmp_path / "figures", [], OWN)}
    assert list(pictures) == ["retest", "optimisation_history", "slices_1", "trial_coordinates_1", "budget"]
    assert pictures["optimisation_history"].caption.endswith(": pruned trials, at the edge.")
    assert tips(pictures["budget"]) == [
        "2 done: 1,600 env steps",
        "1 pruned: 8 env steps",
        "saved by pruning: 792 env steps",
    ]
    names = {path.name for path in write_tables(whole, tmp_path / "tables", OWN)}
    assert names >= {"trials.csv", "trials.tex", "retest.csv", "retest.tex"}
    with (tmp_path / "tables" / "trials.csv").open() as file:
        written = list(csv.DictReader(file))
    assert [row["state"] for row in written] == ["done", "done", "pruned"]
    assert [row["success_auc"] for row in written] == ["0.45", "0.85", ""]
    assert [row["buffer.n_sampled_goal"] for row in written] == ["4", "", "4"]
    assert [row["env_steps"] for row in written] == ["800", "800", "8"]


def test_several_objectives_have_a_front_and_costs_without_a_value_are_said_to_be_missed(folder, tmp_path):
    trials = [trial(0.5, 60.0), trial(0.7, 0.5e5 + 9, rate=2e-3), trial(0.4, 70.0, rate=3e-3)]
    whole = replace(report(), tuning=tuning(folder, trials, objective=["success_auc", "cost_to_95"]))
    pictures = {picture.name: picture for picture in draw(whole, tmp_path, [], OWN)}
    assert {"pareto_front", "slices_1", "slices_2", "trial_coordinates_1", "trial_coordinates_2"} <= set(pictures)
    assert "the 2 trials that no other beats in all of them. Missed: some" in pictures["pareto_front"].caption
    assert "missed" in pictures["optimisation_history"].svg
    assert any(tip.endswith("1 of 2 seeds never hold 95 %") for tip in tips(pictures["pareto_front"]))


def test_names_in_a_search_can_do_no_harm(folder, tmp_path):
    bad = "<script>window.pwned = 1</script> $x_1$ | =1+1"
    retested(folder, "success_auc", (0, [0.5, 0.6], [0.5, 0.7]))
    found = tuning(folder, [trial(0.5, reason=bad, changes={bad: bad}), trial(0.6, changes={"x": bad}, rate=2e-3)])
    factors = [replace(factor, name=bad) for factor in found.parameters]
    found = replace(found, parameters=factors, retested=[replace(found.retested[0], label=bad)])
    whole = replace(report(), tuning=found, claims=list(claims(found)))
    written = page(whole, draw(whole, tmp_path, [], OWN)) + markdown(whole)
    assert "<script>window.pwned" not in written


def test_without_a_search_there_is_nothing_of_it_and_optuna_is_not_asked(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "optuna", None)  # importing it fails
    (tmp_path / "one").mkdir()
    plain = report("one", "../two", "three")
    assert with_search(plain, tmp_path) == plain
    assert plain.plain()["tuning"] is None
    assert draw(plain, tmp_path, [], OWN) == []
    assert not {path.stem for path in write_tables(plain, tmp_path, OWN)} & {"trials", "retest"}
    assert "The search" not in page(plain, sections=OWN)


def test_reports_import_no_optuna():
    code = "import sys, parking_exp.reports.render.files, parking_exp.reports.tuning; print('optuna' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout == "False\n"


def test_a_report_has_the_search_in_the_folder_of_its_experiment(begun):
    found = with_search(report("smoke"), begun.parent)
    assert [one.values for one in found.tuning.trials] == [[0.5], [0.25]]
    assert (found.tuning.experiment, found.tuning.n_trials) == ("smoke", 3)
    assert found.warnings == [
        "Cells of a search have runs with its tuning seeds, by which trials were chosen; none was run again on fresh "
        "seeds."
    ]
    retested(begun, "success_auc", (0, [0.5, 0.5], [0.25, 0.5]))
    found = with_search(report("smoke"), begun.parent)
    assert found.claims[0].startswith("Of the 1 trial trained again on fresh seeds, “trial 0: as it stands” does best")
    assert found.warnings[-1].endswith("; the table of re-runs is the fair comparison.")


def test_of_several_searches_the_first_that_can_be_read_is_shown(begun):
    (begun.parent / "broken").mkdir()
    write_search(begun.parent / "broken", search={"name": "x"})
    (begun.parent / "later").mkdir()
    write_search(begun.parent / "later")
    found = with_search(report("none", "broken", "smoke", "later"), begun.parent)
    assert found.tuning.experiment == "smoke"
    assert found.warnings[0].startswith("The search of broken is left out: ")
    assert found.notes[-1] == "The report shows the search of smoke, and not those of later."


def test_a_storage_that_fails_leaves_the_report_as_it_is_with_a_warning_without_passwords(folder):
    write_search(folder, storage="nonsense+driver://me:secret@localhost/studies")
    plain, place = report("smoke"), "storage=nonsense+driver://me@localhost/studies"
    found = with_search(plain, folder.parent, place.removeprefix("storage="))
    (warning,) = found.warnings
    assert warning.startswith(f"The search of smoke is left out: {place}: the study can't be opened: ")
    assert "secret" not in warning
    assert replace(found, warnings=plain.warnings) == plain
    (warning,) = with_search(plain, folder.parent).warnings
    assert warning.endswith(
        f"left out: the study is in nonsense+driver://me@localhost/studies; pass {place} to read it."
    )


def test_a_study_in_the_storage_that_is_passed_is_read(folder, tmp_path):
    uri = f"sqlite:///{tmp_path}/elsewhere.db"
    write_search(folder, storage=uri)
    plain = report("smoke")
    assert with_search(plain, folder.parent).tuning is None
    assert not (tmp_path / "elsewhere.db").exists()
    study = optuna.create_study(study_name="smoke", storage=storage_of(folder, uri), direction="maximize")
    study.add_trial(trial(0.5))
    assert [one.values for one in with_search(plain, folder.parent, uri).tuning.trials] == [[0.5]]


def test_a_wrong_value_in_a_study_leaves_it_out_with_a_sentence(begun):
    study = optuna.load_study(study_name="smoke", storage=storage_of(begun, None))
    study.add_trial(trial(0.5, values_by_seed="x"))
    assert with_search(report("smoke"), begun.parent).warnings == [
        "The search of smoke is left out: the study is damaged: trial 2 has no valid by_seed."
    ]


def test_a_mistake_of_ours_is_not_told_as_a_storage_that_fails(begun, monkeypatch):
    monkeypatch.setattr("parking_exp.reports.tuning.budget", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        with_search(report("smoke"), begun.parent)


@pytest.mark.parametrize("of", ["optuna.Study.get_trials", "optuna.importance.get_param_importances"])
def test_a_storage_that_fails_later_leaves_the_search_out_as_well(begun, monkeypatch, of):
    def fail(*_, **__):
        raise OSError("it is gone")

    monkeypatch.setattr("parking_exp.reports.tuning.FEWEST_TRIALS", 2)
    monkeypatch.setattr(of, fail)
    found = with_search(report("smoke"), begun.parent)
    assert found.tuning is None
    assert found.warnings == [
        "The search of smoke is left out: the storage of study smoke fails: it is gone; type it again later."
    ]


def test_pruned_runs_are_neither_missing_nor_unfinished_and_cells_of_them_alone_are_left_out(output_dir):
    def look(label, seed):
        if label == "td3" or (label, seed) == ("ddpg", 1):
            return Look(status="pruned")
        return Look(success=0.8)

    cells = {name: [f"algorithm={name}"] for name in ("sac", "td3", "ddpg")}
    make_store(output_dir, "one", cells, range(2), look, bulk=True)
    make_store(
        output_dir, "one", {"far": compose("algorithm.gamma=0.5")}, [0], lambda *_: Look(status="pruned"), bulk=True
    )
    results = load("one", output_dir=output_dir)
    found = build(results, Question(experiments=["one"]), find_untracked(results.runs, output_dir, ["one"]))
    assert {cell.label: cell.counts for cell in found.cells} == {
        "sac": {"done": 2, "running": 0, "failed": 0, "pending": 0},
        "ddpg": {"done": 1, "running": 0, "failed": 0, "pending": 0, "pruned": 1},
    }
    assert found.missing == []
    assert list(found.provenance.unfinished) == []
    assert found.notes[0] == ("2 trials of the search were pruned before a run was done; they are not among the cells.")


def test_runs_that_are_missing_are_counted_without_the_pruned_ones(output_dir):
    states = ("done", "pruned", "failed")
    make_store(
        output_dir, "one", {"sac": []}, range(3), lambda _, seed: Look(status=states[seed], error="no way"), bulk=True
    )
    results = load("one", output_dir=output_dir)
    found = build(results, Question(experiments=["one"]))
    assert found.missing == ["1 of 2 runs are done: 1 failed."]
    assert [run.status for run in found.provenance.unfinished] == ["failed"]
