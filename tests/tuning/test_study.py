"""The study of a search: who works on which trial, after kills, in several processes, with changed
searches.
"""

import json
import multiprocessing
import os
import signal
import time

import pytest
from support.searches import base, settings

from parking_exp.errors import ConfigError, StoreError, UntrustedError
from parking_exp.tuning.study import STUDY_FILE, changes_of, claim, open_study
from parking_exp.tuning.trials import read_trials

VALUES = {"algorithm.gamma": 0.95}  # of the unchanged config


def opened(tmp_path, search=None, values=VALUES):
    return open_study(tmp_path / "test", search or settings(), base(tmp_path), values, {})


def finish(opened, n_trials, search=None, value=0.5):
    """Claim a trial and end it with a value; return its number and changes."""
    trial, lock = claim(opened, search or settings(), n_trials)
    opened.study.tell(trial, value)
    lock.release()
    return trial.number, changes_of(trial, settings().space)


def states(opened, n_trials):
    return [
        row.state for row in read_trials(opened.study, opened.folder, settings().space, n_trials)
    ]


@pytest.mark.parametrize(("gamma", "parameters"), [(0.95, {"algorithm.gamma": 0.95}), (0.5, {})])
def test_trial_0_is_the_unchanged_config_whose_values_the_sampler_knows(
    tmp_path, gamma, parameters
):
    study = opened(tmp_path, values={"algorithm.gamma": gamma})
    assert finish(study, 3) == (0, {})
    assert (
        study.study.get_trials()[0].params == parameters
    )  # what is outside of the space is not one
    number, changes = finish(study, 3)
    assert (number, 0.9 <= changes["algorithm.gamma"] <= 0.99) == (1, True)
    assert claim(study, settings(), 2) is None
    assert finish(study, 3)[0] == 2  # a call with more continues
    assert claim(study, settings(), 3) is None


def test_an_abandoned_trial_is_resumed_with_what_it_had(tmp_path):
    study = opened(tmp_path)
    finish(study, 2)
    trial, lock = claim(study, settings(), 2)
    assert claim(opened(tmp_path), settings(), 2) is None
    trial.report(0.25, 3)
    lock.release()
    again, _ = claim(opened(tmp_path), settings(), 2)
    assert (again.number, again.params) == (1, trial.params)
    assert study.study.get_trials()[1].intermediate_values == {3: 0.25}
    assert states(study, 2) == ["done", "running"]


def _claim_and_hang(path, held):
    trial, lock = claim(opened(path), settings(), 5)
    held.send(trial.number)
    time.sleep(600)
    lock.release()


def test_a_trial_whose_process_was_killed_is_free_at_once(tmp_path):
    receive, send = multiprocessing.Pipe()
    context = multiprocessing.get_context("fork")
    process = context.Process(target=_claim_and_hang, args=(tmp_path, send), daemon=True)
    process.start()
    assert receive.recv() == 0
    study = opened(tmp_path)
    assert claim(study, settings(), 1) is None
    assert states(study, 1) == ["running"]
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    assert states(study, 1) == ["pending"]
    assert claim(study, settings(), 1)[0].number == 0


def test_a_restarted_search_repeats_no_trial(tmp_path):
    """Also with another sampler and pruner, which may change later."""
    other = settings(sampler="random", pruner="median")
    changes = [
        finish(opened(tmp_path, search), 4, search)[1] for search in (settings(), *[other] * 3)
    ]
    assert changes[0] == {}
    assert len({values["algorithm.gamma"] for values in changes[1:]}) == 3


@pytest.mark.parametrize(
    "half", [b'{"op_code":4,"worker_id"', b"{" + 2**21 * b"x"], ids=["short", "long"]
)
def test_an_incomplete_line_that_a_kill_left_in_the_journal_is_removed(tmp_path, half):
    study = opened(tmp_path)
    first, _ = claim(study, settings(), 3)
    path = study.folder / STUDY_FILE
    before = path.read_bytes()
    with path.open("ab") as file:
        file.write(half)
    assert (first.number, claim(opened(tmp_path), settings(), 3)[0].number) == (0, 1)
    assert path.read_bytes().startswith(before)
    assert all(json.loads(line) for line in path.read_text().splitlines())


@pytest.mark.parametrize(
    ("override", "changes", "key"),
    [
        (
            "experiment=smoke",
            {"space": {"algorithm.gamma": {"uniform": [0.9, 0.995]}}},
            "search.space.algorithm.gamma",
        ),
        ("experiment=smoke", {"tuning_seeds": [1001, 1003]}, "search.tuning_seeds"),
        ("total_timesteps=401", {}, "base config"),
        ("evaluation.final_n_scenes=6", {}, r"evaluation\.final_n_scenes"),
    ],
)
def test_the_study_of_another_search_or_config_is_refused_and_what_differs_is_named(
    tmp_path, override, changes, key
):
    opened(tmp_path)
    with pytest.raises(ConfigError, match=f"another {key};"):
        open_study(tmp_path / "test", settings(**changes), base(tmp_path, override), VALUES, {})


def test_a_journal_that_is_damaged_is_reported_in_one_sentence(tmp_path):
    study = opened(tmp_path)
    (study.folder / STUDY_FILE).write_text("{}\n")
    with pytest.raises(StoreError, match=r"^the study test can't be used: ") as error:
        opened(tmp_path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "name", ["study.journal", "study.journal.lock", ".claiming", ".trials/00000.lock"]
)
def test_files_of_a_search_that_are_links_out_of_its_folder_are_refused(tmp_path, name):
    link = tmp_path / "test" / name
    link.parent.mkdir(parents=True)
    link.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UntrustedError, match=str(link)):
        opened(tmp_path)
    assert not (tmp_path / "elsewhere").exists()
