"""The parts of a report that a hyperparameter search has, from studies with made-up trials."""

import csv
import json
import subprocess
import sys
from dataclasses import asdict, replace
from statistics import mean

import optuna
import pytest
import scipy.stats
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.trial import TrialState, create_trial
from pydantic import TypeAdapter
from support import report_factory
from support.searches import settings
from support.store_factory import Look, compose, make_store

from parking_exp.errors import ResultsError
from parking_exp.reports.build import Question, build
from parking_exp.reports.export import _plain
from parking_exp.reports.figures.export import draw
from parking_exp.reports.figures.studies import FEWEST_TRIALS, importance, study_of
from parking_exp.reports.render.files import write_tables
from parking_exp.reports.render.markdown import markdown
from parking_exp.reports.render.page import page
from parking_exp.reports.sections import SECTIONS
from parking_exp.reports.tuning import tuning_of, with_search
from parking_exp.reports.tuning_data import Tuning
from parking_exp.reports.tuning_findings import claims, retest_text, search_text
from parking_exp.reports.untracked import find_untracked
from parking_exp.results.frames import load
from parking_exp.runs.files import write_json
from parking_exp.statistics import mean_interval
from parking_exp.tuning.study import storage_of
from parking_exp.tuning.trials import rows

SPACE = {
    "algorithm.learning_rate": {"log": [1e-4, 1e-2]},
    "algorithm.gamma": {"uniform": [0.9, 0.99]},
    "buffer": {"choices": ["her_future", "replay"]},
    "buffer.n_sampled_goal": {"int": [1, 8]},
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
    study = optuna.create_study(directions=["maximize"] * len(search.objective))
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


def names_of(pictures):
    return [picture.name for picture in pictures]


def test_states_are_counted_and_the_best_trial_is_named(folder):
    found = tuning(folder, [trial(0.2), trial(state="pruned"), trial(0.6), trial(state="failed", reason="no")], 6)
    assert found.trials[3].reason == "no"
    (about,) = search_text(replace(report(), tuning=found))
    assert "6 trials (sampler tpe, pruner none): 2 done, 1 pruned, 1 failed, 2 pending." in about
    assert "success_auc, mean over 2 tuning seeds" in about
    assert "“trial 2: learning_rate=0.001, gamma=0.95, her_future, n_sampled_goal=4” with 60.0 %" in about


def test_conditional_parameters_are_missing_where_they_do_not_apply(folder):
    found = tuning(folder, [trial(0.2, gamma=0.98), trial(0.3, rate=1e-4, buffer="replay")])
    assert list(found.parameters) == list(DISTRIBUTIONS)
    assert found.parameters["buffer"]["attributes"]["choices"] == ["her_future", "replay"]
    assert found.trials[0].parameters == {
        "algorithm.learning_rate": 1e-3, "1 - algorithm.gamma": 0.02, "buffer": "her_future", "buffer.n_sampled_goal": 4
    }  # fmt: skip
    assert "buffer.n_sampled_goal" not in found.trials[1].parameters


def many(folder, **changes):
    """A search whose values follow from the learning rate alone."""
    rates = [10 ** (-4 + k / 20) for k in range(40)]
    trials = [
        trial(k / 40, rate=rates[k], gamma=0.9 + 0.09 * (k * 7 % 40) / 40, buffer=("her_future", "replay")[k % 2])
        for k in range(40)
    ]
    return tuning(folder, trials, **changes)


def test_the_study_of_an_export_has_the_importances_of_the_study(folder):
    found = many(folder)
    exported = TypeAdapter(Tuning).validate_python(json.loads(json.dumps(_plain(asdict(found)))))
    importances = [optuna.importance.get_param_importances(study_of(one)) for one in (found, exported)]
    assert importances[0] == pytest.approx(importances[1])
    assert next(iter(importances[0])) == "algorithm.learning_rate"
    assert importances[0]["algorithm.learning_rate"] > 0.5


def test_importance_takes_trials_that_differ(folder):
    assert importance(replace(report(), tuning=many(folder))) is not None
    few = [trial(k / 20, rate=1e-3 + k * 1e-4) for k in range(FEWEST_TRIALS - 1)]
    same = [trial(0.5, rate=1e-3 + k * 1e-4) for k in range(FEWEST_TRIALS)]
    for trials in (few, same):
        assert importance(replace(report(), tuning=tuning(folder, trials))) is None


def test_retrained_trials_have_intervals_and_welchs_for_tuning_minus_test(folder):
    tuned, test = [0.9, 0.8], [0.7, 0.6, 0.8]
    retested(folder, "success_auc", (1, tuned, test), (0, [0.5, 0.4], [0.5, 0.4, 0.6]))
    found = tuning(folder, [trial(0.45), trial(0.85)])
    best = found.retested[0]
    assert (best.number, best.tuning.value, best.test.value) == (1, mean(tuned), pytest.approx(0.7))
    assert (best.test.low, best.test.high) == (mean_interval(test).low, mean_interval(test).high)
    expected = scipy.stats.ttest_ind(tuned, test, equal_var=False).confidence_interval()
    assert best.difference.value == pytest.approx(0.15)
    assert (best.difference.low, best.difference.high) == pytest.approx((expected.low, expected.high))
    (claim,) = claims(found)
    assert "“trial 1: as it stands” is the best of 2 retrained trials: success_auc 70.0 % [" in claim
    assert "tuning minus test +15.0 points [" in claim
    assert len(retest_text(replace(report(), tuning=found))) == 1


@pytest.mark.parametrize("values", [{"tuning": []}, {"tuning": [2.0]}, {"tuning": None}, {"label": None}])
def test_a_retest_that_can_not_be_read_is_left_out_with_a_sentence(folder, values):
    stored = {"number": 0, "label": "x", "changes": {}, "tuning": [0.5], "test": [0.5]}
    write_json(folder / "retest.json", {"objective": "success_auc", "trials": [{**stored, **values}]})
    found = tuning(folder, [trial(0.5)])
    assert found.retested == []
    assert "retest.json" in found.notes[-1]


def test_everything_goes_into_json_and_back(folder):
    retested(folder, "success_auc", (0, [0.5], [0.5]))  # one seed: no interval
    found = tuning(folder, [trial(0.5), trial(state="pruned")])
    plain = json.loads(json.dumps(replace(report(), tuning=found).plain(), allow_nan=False))
    assert TypeAdapter(Tuning).validate_python(plain["tuning"]) == found


def test_figures_and_tables_show_the_trials(folder, tmp_path):
    retested(folder, "success_auc", (1, [0.9, 0.8], [0.7, 0.6]))
    found = tuning(folder, [trial(0.45), trial(0.85, rate=2e-3, buffer="replay"), trial(state="pruned", env_steps=8)])
    whole = replace(report(), tuning=found)
    assert names_of(draw(whole, tmp_path / "figures", [], OWN)) == [
        "optimisation_history", "slices_1", "trial_coordinates"
    ]  # fmt: skip
    names = {path.name for path in write_tables(whole, tmp_path / "tables", OWN)}
    assert names >= {"trials.csv", "trials.tex", "retest.csv", "retest.tex"}
    with (tmp_path / "tables" / "trials.csv").open() as file:
        written = list(csv.DictReader(file))
    assert [row["state"] for row in written] == ["done", "done", "pruned"]
    assert [row["success_auc"] for row in written] == ["0.45", "0.85", ""]
    assert [row["buffer.n_sampled_goal"] for row in written] == ["4", "", "4"]
    assert [row["env_steps"] for row in written] == ["800", "800", "8"]


def test_several_objectives_have_a_front_and_slices_of_each(folder, tmp_path):
    trials = [trial(0.5, 0.6), trial(0.7, 0.5, rate=2e-3), trial(0.4, 0.4, rate=3e-3), trial(state="failed")]
    whole = replace(report(), tuning=tuning(folder, trials, objective=["success_auc", "final_parked"]))
    assert names_of(draw(whole, tmp_path, [], OWN)) == [
        "optimisation_history", "pareto_front", "slices_1", "slices_2", "trial_coordinates"
    ]  # fmt: skip


def test_a_search_of_an_export_that_does_not_fit_together_gets_a_sentence(folder, tmp_path):
    found = tuning(folder, [trial(0.5), trial(0.6, rate=2e-3)])
    wrong = {**found.parameters, "algorithm.learning_rate": {"name": "os.system", "attributes": {}}}
    with pytest.raises(ResultsError, match="the search of smoke"):
        draw(replace(report(), tuning=replace(found, parameters=wrong)), tmp_path, [], OWN)


def test_names_in_a_search_can_do_no_harm(folder, tmp_path):
    bad = "<script>window.pwned = 1</script> $x_1$ | =1+1 \x00\x1b"
    retested(folder, "success_auc", (0, [0.5, 0.6], [0.5, 0.7]))
    found = tuning(folder, [trial(0.5, reason=bad, changes={bad: bad}), trial(0.6, changes={"x": bad}, rate=2e-3)])
    found = replace(
        found,
        parameters={bad: found.parameters["algorithm.learning_rate"]},
        trials=[replace(one, parameters={bad: one.parameters["algorithm.learning_rate"]}) for one in found.trials],
        retested=[replace(found.retested[0], label=bad)],
    )
    whole = replace(report(), tuning=found, claims=list(claims(found)))
    pictures = draw(whole, tmp_path, ["svg"], OWN)
    assert "slices_1" in names_of(pictures)
    assert "<script>window.pwned" not in page(whole, pictures) + markdown(whole)


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
        "Cells of a search include runs on the tuning seeds that trials were selected by; none was retrained on fresh "
        "seeds."
    ]
    retested(begun, "success_auc", (0, [0.5, 0.5], [0.25, 0.5]))
    found = with_search(report("smoke"), begun.parent)
    assert found.claims[0].startswith("On 2 fresh seeds, “trial 0: as it stands” is the best of 1 retrained trial")
    assert found.warnings[-1].endswith("; compare the trials retrained on fresh seeds.")


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
    assert warning.startswith("The search of smoke is left out: ")
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
