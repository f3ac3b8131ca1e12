"""The study of a search: who works on which trial, after kills, with several processes, and with other searches."""

import json
import multiprocessing
import os
import signal
import time

import optuna
import pytest
from support.searches import base, settings

from parking_exp.errors import ConfigError, StoreError, UntrustedError
from parking_exp.tuning import claims
from parking_exp.tuning.claims import claim, make_sampler
from parking_exp.tuning.study import STUDY_FILE, load_study, open_study, storage_of
from parking_exp.tuning.trials import rows


def values(changes):
    return {"algorithm.gamma": 0.95, **changes}


def opened(tmp_path, search=None, url=None):
    folder = tmp_path / "test"
    storage = storage_of(folder, url)
    return open_study(folder, search or settings(), base(tmp_path), values, storage), folder


def numbers_of(study, state):
    return [trial.number for trial in study.study.get_trials() if trial.state.name == state]


def test_trial_0_is_the_config_as_it_stands_and_what_is_enqueued_follows(tmp_path):
    search = settings(enqueue=[{"algorithm.gamma": 0.98}, {"algorithm.batch_size": 64}])
    study, _ = opened(tmp_path, search)
    taken = [claim(study, search, 4) for _ in range(4)]
    assert [one.number for one in taken] == [0, 1, 2, 3]
    assert [one.changes for one in taken[:3]] == [{}, {"algorithm.gamma": 0.98}, {"algorithm.batch_size": 64}]
    assert 0.9 <= taken[3].changes["algorithm.gamma"] <= 0.99
    params = [trial.params for trial in study.study.get_trials()]
    assert params[:3] == [{"1 - algorithm.gamma": 0.05}, {"1 - algorithm.gamma": 0.02}, {"1 - algorithm.gamma": 0.05}]
    assert claim(study, search, 4) is None


def test_no_trial_is_begun_beyond_n_trials_and_more_go_on_from_there(tmp_path):
    study, _ = opened(tmp_path)
    for _ in range(3):
        one = claim(study, settings(), 3)
        study.study.tell(one.trial, 0.5)
        one.release()
    assert claim(study, settings(), 3) is None
    assert claim(study, settings(), 4).number == 3


def test_a_trial_that_is_begun_beyond_n_trials_waits_for_a_call_with_more(tmp_path, monkeypatch):
    study, folder = opened(tmp_path, settings(enqueue=[{"algorithm.gamma": 0.98}]))
    other, _ = opened(tmp_path, settings(enqueue=[{"algorithm.gamma": 0.98}]))
    ask = study.study.ask

    def ask_second():  # another machine is faster by a moment
        other.study.tell(other.study.ask(), 0.5)
        return ask()

    monkeypatch.setattr(study.study, "ask", ask_second)
    assert claim(study, settings(), 1) is None
    assert (numbers_of(study, "COMPLETE"), numbers_of(study, "RUNNING")) == ([0], [1])
    assert [row.state for row in rows(study.study, folder, 2)] == ["done", "pending"]
    taken = claim(study, settings(), 2)
    assert (taken.number, taken.changes) == (1, {"algorithm.gamma": 0.98})


def test_fewer_trials_than_are_enqueued_leave_the_others_waiting(tmp_path):
    search = settings(enqueue=[{"algorithm.gamma": 0.98}])
    study, _ = opened(tmp_path, search)
    first = claim(study, search, 1)
    assert first.number == 0
    assert claim(study, search, 1) is None
    assert numbers_of(study, "WAITING") == [1]


def test_a_trial_that_was_left_is_taken_up_again_with_what_it_had(tmp_path):
    study, _ = opened(tmp_path)
    first = claim(study, settings(), 2)
    second = claim(study, settings(), 2)
    assert claim(study, settings(), 2) is None
    second.trial.report(0.25, 3)
    second.release()
    again = claim(study, settings(), 2)
    assert (again.number, again.changes) == (second.number, second.changes)
    assert study.study.get_trials()[1].intermediate_values == {3: 0.25}
    first.release()
    assert claim(study, settings(), 2).number == 0


def test_a_trial_that_ends_while_another_process_looks_is_not_taken_up(tmp_path, monkeypatch):
    study, folder = opened(tmp_path)
    first = claim(study, settings(), 1)
    look = claims._try_lock

    def ends_first(*arguments):
        study.study.tell(first.trial, 0.5)
        first.release()
        return look(*arguments)

    monkeypatch.setattr(claims, "_try_lock", ends_first)
    other, _ = opened(tmp_path)
    assert claim(other, settings(), 1) is None
    assert [row.state for row in rows(other.study, folder, 1)] == ["done"]


def _claim_and_hang(path, held):
    study, _ = opened(path)
    taken = claim(study, settings(), 5)
    held.send(taken.number)
    time.sleep(600)
    taken.release()


def test_a_trial_whose_process_was_killed_is_free_at_once(tmp_path):
    receive, send = multiprocessing.Pipe()
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=_claim_and_hang, args=(tmp_path, send), daemon=True)
    process.start()
    assert receive.recv() == 0
    study, folder = opened(tmp_path)
    assert claim(study, settings(), 1) is None
    assert [row.state for row in rows(study.study, folder, 1)] == ["running"]
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    assert [row.state for row in rows(study.study, folder, 1)] == ["pending"]
    assert claim(study, settings(), 1).number == 0


def _do_all(path, n_trials, done):
    study, _ = opened(path)
    while (one := claim(study, settings(), n_trials)) is not None:
        study.study.tell(one.trial, one.changes.get("algorithm.gamma", 0.0))
        done.put(one.number)
        one.release()


@pytest.mark.slow
def test_processes_that_share_a_study_do_each_trial_once(tmp_path):
    context = multiprocessing.get_context("spawn")
    done = context.Queue()
    processes = [context.Process(target=_do_all, args=(tmp_path, 20, done), daemon=True) for _ in range(3)]
    for process in processes:
        process.start()
    found = sorted(done.get(timeout=120) for _ in range(20))
    for process in processes:
        process.join()
    assert found == list(range(20))
    study, _ = opened(tmp_path)
    assert numbers_of(study, "COMPLETE") == list(range(20))


def test_trials_after_a_restart_are_not_those_before_it(tmp_path):
    search = settings(sampler="random")
    values = []
    for _ in range(4):
        study, _ = opened(tmp_path, search)  # a new process samples with a new sampler
        one = claim(study, search, 4)
        values.append(one.changes.get("algorithm.gamma"))
        study.study.tell(one.trial, 0.5)
        one.release()
    assert values[0] is None
    assert len(set(values)) == 4


@pytest.mark.parametrize("half", [b'{"op_code":4,"worker_id"', b"{" + 2**21 * b"x"], ids=["short", "long"])
def test_half_a_line_that_a_kill_left_in_the_journal_is_cut_off(tmp_path, half):
    study, folder = opened(tmp_path)
    first = claim(study, settings(), 3)
    before = (folder / STUDY_FILE).read_bytes()
    with (folder / STUDY_FILE).open("ab") as file:
        file.write(half)
    again, _ = opened(tmp_path)
    assert (first.number, claim(again, settings(), 3).number) == (0, 1)
    assert (folder / STUDY_FILE).read_bytes().startswith(before)
    assert all(json.loads(line) for line in (folder / STUDY_FILE).read_text().splitlines())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"space": {"algorithm.gamma": {"one_minus_log": [0.9, 0.995]}}}, "search.space.algorithm.gamma was"),
        ({"space": {"algorithm.tau": {"log": [0.01, 0.1]}}}, "search.space.algorithm.gamma was"),
        ({"objective": "final_success"}, 'search.objective was ["success_auc"] and is ["final_success"]'),
        ({"tuning_seeds": [1001, 1003]}, "search.tuning_seeds was [1001, 1002] and is [1001, 1003]"),
    ],
)
def test_a_study_of_another_search_is_refused_with_what_differs(tmp_path, changes, words):
    opened(tmp_path)
    with pytest.raises(ConfigError) as error:
        opened(tmp_path, settings(**changes))
    assert words in str(error.value)
    assert "experiment_name=OTHER" in str(error.value)


def test_a_study_of_another_config_is_refused(tmp_path):
    opened(tmp_path)
    folder = tmp_path / "test"
    other = base(tmp_path).model_copy(update={"total_timesteps": 401})
    with pytest.raises(ConfigError, match="base config"):
        open_study(folder, settings(), other, values, storage_of(folder, None))


def test_sampler_and_pruner_may_change_on_the_way(tmp_path):
    study, _ = opened(tmp_path)
    study.study.tell(claim(study, settings(), 2).trial, 0.5)
    other = settings(sampler="random", pruner="median", grace_updates=7)
    again, _ = opened(tmp_path, other)
    assert claim(again, other, 2).number == 1


def test_a_storage_that_can_not_be_reached_gets_a_sentence(tmp_path):
    with pytest.raises(StoreError, match="can't be opened"):
        storage_of(tmp_path / "test", f"sqlite:////{tmp_path}/nowhere/study.db")
    assert load_study("none", storage_of(tmp_path / "test", None)) is None


def test_a_storage_that_fails_while_trials_are_read_gets_a_sentence(tmp_path, monkeypatch):
    study, folder = opened(tmp_path)

    def fail(**_):
        raise OSError("postgresql://me:secret@here is gone\nand more")

    monkeypatch.setattr(study.study, "get_trials", fail)
    with pytest.raises(StoreError) as error:
        rows(study.study, folder, 1)
    assert str(error.value) == "the storage of study test fails: postgresql://me@here is gone; try again later"


def test_a_study_in_a_database_is_shared_in_the_same_way(tmp_path):
    url = f"sqlite:///{tmp_path}/study.db"
    study, folder = opened(tmp_path, url=url)
    one = claim(study, settings(), 2)
    study.study.tell(one.trial, 0.5)
    again, _ = opened(tmp_path, url=url)
    other = claim(again, settings(), 2)
    assert other.number == 1
    assert [row.state for row in rows(again.study, folder, 2)] == ["done", "running"]


@pytest.mark.parametrize("name", ["study.journal", "study.journal.lock", ".claiming", ".trials", ".trials/00000.lock"])
def test_files_of_a_search_that_are_links_out_of_its_folder_are_refused(tmp_path, name):
    link = tmp_path / "test" / name
    link.parent.mkdir(parents=True)
    link.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UntrustedError) as error:
        opened(tmp_path)
    assert str(error.value) == f"{link} is a symbolic link that leads out of {tmp_path / 'test'}; remove it"
    assert not (tmp_path / "elsewhere").exists()


def test_the_folder_of_a_search_and_those_of_its_cells_may_lie_on_another_disk(tmp_path):
    for name in ("disk/test", "disk/cell"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "test").symlink_to(tmp_path / "disk" / "test")
    (tmp_path / "test" / "cell").symlink_to(tmp_path / "disk" / "cell")
    opened(tmp_path)
    assert (tmp_path / "disk" / "test" / STUDY_FILE).exists()


@pytest.mark.parametrize(
    ("state", "values", "attributes", "what"),
    [
        ("COMPLETE", [0.5], {"changes": ["x"]}, "changes"),
        ("COMPLETE", [0.5], {"values_by_seed": 0.5}, "by_seed"),
        ("COMPLETE", [0.5], {"runs": "a/b"}, "runs"),
        ("COMPLETE", [0.5], {"runs": [1]}, "runs"),
        ("FAIL", None, {"env_steps": "many"}, "env_steps"),
        ("FAIL", None, {"cpu_s": float("nan")}, "cpu_s"),
        ("FAIL", None, {"reason": {}}, "reason"),
        ("COMPLETE", [float("inf")], {}, "values"),
    ],
)
def test_a_wrong_value_in_a_study_is_named_with_its_trial(tmp_path, state, values, attributes, what):
    study, folder = opened(tmp_path)
    study.study.add_trial(
        optuna.trial.create_trial(state=optuna.trial.TrialState[state], values=values, user_attrs=attributes)
    )
    with pytest.raises(ConfigError) as error:
        rows(study.study, folder, 2)
    assert str(error.value) == f"the study is damaged: trial 1 has no valid {what}"


def test_more_values_than_objectives_are_refused_too(tmp_path):
    study, folder = opened(tmp_path)
    study.study.tell(claim(study, settings(), 1).trial, 0.5)
    journal = folder / STUDY_FILE
    assert journal.read_text().count('"values":[0.5]') == 1
    journal.write_text(journal.read_text().replace('"values":[0.5]', '"values":[0.5,0.25]'))
    with pytest.raises(ConfigError, match=r"^the study is damaged: trial 0 has no valid values$"):
        rows(opened(tmp_path)[0].study, folder, 1)


def _optimum(params):
    """A synthetic objective over five parameters, with its optimum at 0."""
    return sum((value - 0.3 - 0.1 * place) ** 2 for place, value in enumerate(params))


def _trials_to(level, sampler, seed, most=400):
    study = optuna.create_study()
    search = settings(sampler=sampler)
    for number in range(most):
        study.sampler = make_sampler(search, seed * 1000 + number)
        trial = study.ask()
        value = _optimum([trial.suggest_float(str(place), 0, 1) for place in range(5)])
        study.tell(trial, value)
        if value < level:
            return number + 1
    return most


@pytest.mark.slow
def test_tpe_needs_six_tenths_of_the_trials_of_random_search_at_most():
    medians = {}
    for sampler in ("tpe", "random"):
        needed = sorted(_trials_to(0.06, sampler, seed) for seed in range(20))
        medians[sampler] = (needed[9] + needed[10]) / 2
    assert medians["tpe"] <= 0.6 * medians["random"], medians


def _open_at_once(path, barrier, failures):
    barrier.wait()
    try:
        storage_of(path / str(os.getpid()), f"sqlite:///{path}/study.db")
    except StoreError as error:
        failures.put(str(error))


def test_processes_that_meet_an_empty_database_at_once_all_open_it(tmp_path):
    context = multiprocessing.get_context("spawn")
    barrier, failures = context.Barrier(4), context.Queue()
    processes = [context.Process(target=_open_at_once, args=(tmp_path, barrier, failures)) for _ in range(4)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert failures.empty(), failures.get()
