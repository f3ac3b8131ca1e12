"""The parts of a report that a hyperparameter search has, from studies with made-up trials."""

import csv
from dataclasses import replace
from functools import cache

import optuna
import pytest
from optuna.trial import TrialState, create_trial
from support import report_factory
from support.searches import settings

from parking_exp.reports.figures.study_figures import (
    MIN_TRIALS,
    draw_parameter_importance,
    rebuild_study,
)
from parking_exp.reports.report_files import write_tables
from parking_exp.reports.search_report import (
    describe_search,
    with_search,
    with_stored_search,
)
from parking_exp.reports.sections import SECTIONS, draw_figures, section_contents
from parking_exp.runs.atomic_files import write_json
from parking_exp.statistics import SeedRates, compare, mean_interval
from parking_exp.tuning.search import read_search
from parking_exp.tuning.study import open_storage

SPACE = {
    "algorithm.learning_rate": {"log": [1e-4, 1e-2]},
    "buffer": {"choices": ["her_future", "replay"]},
    "buffer.n_sampled_goal": {"int": [1, 8]},
}
OWN = [section for section in SECTIONS if section.id in ("retest", "tuning")]


def trial(*values, rate=1e-3, buffer="her_future", **attributes):
    """A trial of a study, pruned if it has no value, with what a worker notes of it."""
    parameters = {"algorithm.learning_rate": rate, "buffer": buffer}
    if buffer == "her_future":
        parameters["buffer.n_sampled_goal"] = 4
    space = settings(space=SPACE).space
    return create_trial(
        state=TrialState.COMPLETE if values else TrialState.PRUNED,
        values=values or None,
        params=parameters,
        distributions={name: space[name].distribution() for name in parameters},
        user_attrs=attributes,
    )


def add(folder, *trials):
    """Add trials to the study of a folder."""
    optuna.create_study(
        study_name="smoke", storage=open_storage(folder), direction="maximize", load_if_exists=True
    ).add_trials(trials)


def write_search(folder, **changes):
    folder.mkdir(exist_ok=True)
    plain = settings(space=SPACE).model_dump(by_alias=True)
    write_json(folder / "search.json", {"n_trials": 3, "search": plain, **changes})


def write_retest(folder, *trials):
    """Write `retest.json`: number, values on tuning seeds, values on test seeds."""
    items = [
        {
            "number": number,
            "label": f"trial {number}: unchanged",
            "changes": {},
            "tuning": tuned,
            "test": test,
        }
        for number, tuned, test in trials
    ]
    write_json(folder / "retest.json", {"trials": items})


def stored_search(folder, trials):
    """What a report has of a search with these trials."""
    add(folder, *trials)
    write_search(folder, n_trials=len(trials))
    return read_search(folder)


def many(folder):
    """A search whose values follow from the learning rate alone."""
    buffers = ("her_future", "replay")
    return stored_search(
        folder, [trial(k / 20, rate=10 ** (-4 + k / 10), buffer=buffers[k % 2]) for k in range(20)]
    )


@pytest.fixture
def folder(tmp_path):
    """The folder of an experiment."""
    return tmp_path / "smoke"


@pytest.fixture
def begun(folder):
    """The folder of a search with two of three trials."""
    stored_search(folder, [trial(0.5), trial(0.25, rate=2e-3)])
    write_search(folder)
    return folder


@cache
def example():
    return report_factory.report(2, 2)


def report(*experiments, search=None):
    """A report on these experiments, with a search."""
    plain = replace(example(), experiments=list(experiments), warnings=[])
    return with_search(plain, search) if search else plain


def written(whole, folder):
    """The rows of the tables of a search, by file."""
    write_tables(section_contents(whole, sections=OWN), folder)
    return {
        path.stem: [*csv.DictReader(path.read_text().splitlines())] for path in folder.glob("*.csv")
    }


def test_a_stored_search_has_the_importances_of_its_study(folder):
    importances = optuna.importance.get_param_importances(rebuild_study(many(folder)))
    assert next(iter(importances)) == "algorithm.learning_rate"
    assert importances["algorithm.learning_rate"] > 0.5


def test_importance_takes_trials_that_differ(tmp_path):
    assert len([*draw_parameter_importance(report(search=many(tmp_path / "smoke")))]) == 1
    few = [trial(k / 20, rate=1e-3 + k * 1e-4) for k in range(MIN_TRIALS - 1)]
    same = [trial(0.5, rate=1e-3 + k * 1e-4) for k in range(MIN_TRIALS)]
    for name, trials in (("few", few), ("same", same)):
        search = stored_search(tmp_path / name / "smoke", trials)
        assert not [*draw_parameter_importance(report(search=search))]


def test_retrained_trials_have_intervals_and_so_has_tuning_minus_test(folder, tmp_path):
    tuned = [0.9, 0.8]
    test = [0.7, 0.6, 0.8]
    folder.mkdir()
    write_retest(folder, (1, tuned, test), (0, [0.5, 0.4], [0.5, 0.4, 0.6]))
    whole = report(search=stored_search(folder, [trial(0.45), trial(0.85)]))
    claim = whole.claims[0]
    assert claim.startswith(
        "On 3 test seeds, “trial 1: unchanged” is the best of 2 retrained trials: "
    )
    assert "success_auc 70.0 % [" in claim and "tuning minus test +15.0 points [" in claim
    assert whole.warnings[-1].endswith("; compare the trials retrained on test seeds.")
    best, other = written(whole, tmp_path / "tables")["retest"]
    assert (best["number"], other["number"]) == ("1", "0")
    assert (best["n_tuning"], best["n_test"]) == ("2", "3")
    (difference,) = compare([([SeedRates(tuned)], [SeedRates(test)])])
    intervals = {
        "tuning": mean_interval(tuned),
        "test": mean_interval(test),
        "difference": difference,
    }
    for name, interval in intervals.items():
        numbers = [float(best[column]) for column in (name, f"{name}_low", f"{name}_high")]
        assert numbers == pytest.approx([interval.value, interval.low, interval.high])


def test_figures_and_tables_show_the_trials(folder, tmp_path):
    search = stored_search(folder, [trial(0.45), trial(0.85, rate=2e-3, buffer="replay"), trial()])
    whole = report(search=search)
    drawn = draw_figures(whole, tmp_path / "figures", [], OWN)
    assert [figure.name for figure in drawn] == ["optimisation_history", "slices"]
    (text,) = describe_search(whole)
    assert "3 trials (sampler tpe, pruner none): 2 done, 1 pruned." in text
    assert "learning_rate=0.002, replay” with 85.0 %" in text
    columns = ("state", "success_auc", "buffer.n_sampled_goal")
    assert [
        tuple(row[name] for name in columns)
        for row in written(whole, tmp_path / "tables")["trials"]
    ] == [
        ("done", "0.45", "4"),
        ("done", "0.85", ""),
        ("pruned", "", "4"),
    ]


def test_without_a_search_there_is_nothing_of_it(tmp_path):
    plain = report("one", "../two")
    (tmp_path / "one").mkdir()
    assert with_stored_search(plain, tmp_path) == plain
    assert draw_figures(plain, tmp_path, [], OWN) == []
    assert not any(
        content.tables or [*content.text] for content in section_contents(plain, sections=OWN)
    )


def test_a_report_has_the_first_search_in_the_folders_of_its_experiments(begun):
    write_search(begun.parent / "later")
    whole = with_stored_search(report("none", "smoke", "later"), begun.parent)
    assert [trial.value for trial in whole.tuning.trials] == [0.5, 0.25]
    assert (whole.tuning.experiment, whole.tuning.n_trials) == ("smoke", 3)
    (warning,) = whole.warnings
    assert warning.endswith("; none was retrained on test seeds.")


def test_a_damaged_search_does_not_hide_the_next_one(begun):
    write_search(begun.parent / "earlier", search={"name": "x"})
    whole = with_stored_search(report("earlier", "smoke"), begun.parent)
    assert whole.tuning.experiment == "smoke"
    assert whole.warnings[0].startswith("The search of earlier is left out: ")


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda folder: write_search(folder, search={"name": "x"}), "space"),
        (lambda folder: write_retest(folder, (0, [2.0], [0.5])), "the study smoke can't be used: "),
        (lambda folder: add(folder, trial(0.5, by_seed="x")), "the study smoke can't be used: "),
    ],
    ids=["settings", "retest", "trial"],
)
def test_a_search_that_is_damaged_is_left_out_with_a_warning(begun, damage, words):
    damage(begun)
    plain = report("smoke")
    whole = with_stored_search(plain, begun.parent)
    (warning,) = whole.warnings
    assert warning.startswith("The search of smoke is left out: ") and words in warning
    assert replace(whole, warnings=plain.warnings) == plain
