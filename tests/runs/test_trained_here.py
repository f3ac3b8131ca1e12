"""Runs with classes of the user's own are trusted where this user has trained them, and nowhere
else.
"""

import os
import shutil

import pytest
from support.runs import ROOT, call_script, evaluate_stored, only_run, run_script
from support.sweep_processes import QUICK

from parking_exp import load_model
from parking_exp.config.compose import compose
from parking_exp.errors import UntrustedError
from parking_exp.runs.trained_here import record_training, was_trained_here
from parking_exp.sweeps.single_run import train

OWN = (*QUICK, "algorithm._target_=support.user_algorithms.SavesExtraNetwork")
REFUSAL = (
    r"^algorithm\._target_=support\.user_algorithms\.SavesExtraNetwork in .* is not on the "
    r"allow-list, and the run was not trained here; trust=true \(in Python trust=True\) allows it, "
    r"if you trust its author$"
)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The output directory of a run with a class of the user's own."""
    output_dir = tmp_path_factory.mktemp("trained") / "outputs"
    train(compose(*OWN, f"output_dir={output_dir}"))
    return output_dir


def test_an_own_run_is_exported_loaded_and_evaluated_without_more_ado(trained, tmp_path):
    run = only_run(trained).path
    done = call_script(
        "export", f"run='{run}'", f"path={tmp_path / 'policy.safetensors'}", "format=safetensors"
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert type(load_model("latest", trained)).__name__ == "SavesExtraNetwork"
    evaluate_stored(run)


def test_runs_of_a_sweep_are_recorded_by_their_workers(tmp_path):
    environment = {"PYTHONPATH": str(ROOT / "tests")}
    run_script("train", *OWN, "seeds=2", f"output_dir={tmp_path}", env=environment, code=0)
    assert all(was_trained_here(path) for path in tmp_path.glob("*/*/seed=*"))


def test_a_copy_from_elsewhere_is_refused_whatever_it_brings(trained, state_home, tmp_path):
    shutil.copytree(trained, tmp_path / "outputs")
    shutil.copytree(state_home, tmp_path / "outputs", dirs_exist_ok=True)
    with pytest.raises(UntrustedError, match=REFUSAL):
        evaluate_stored(only_run(tmp_path / "outputs").path)
    with pytest.raises(UntrustedError, match=REFUSAL):
        load_model("latest", tmp_path / "outputs")
    assert load_model("latest", tmp_path / "outputs", trust=True) is not None


def test_another_config_in_its_place_is_refused(trained, tmp_path):
    shutil.copytree(trained, tmp_path / "outputs")
    run = only_run(tmp_path / "outputs")
    record_training(run.path, run.read_config())
    assert was_trained_here(run.path)
    config = run.path / "config.yaml"
    config.write_text(config.read_text().replace("SavesExtraNetwork", "Exits"))
    with pytest.raises(
        UntrustedError, match=r"^algorithm\._target_=support\.user_algorithms\.Exits in "
    ):
        evaluate_stored(run.path)


def test_a_link_to_an_own_run_is_that_run(trained, tmp_path):
    (tmp_path / "link").symlink_to(trained)
    assert was_trained_here(only_run(tmp_path / "link").path)


def test_runs_without_own_classes_are_not_recorded(smoke, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    record_training(smoke.path, smoke.read_config())
    assert list(tmp_path.iterdir()) == []


def test_an_own_run_is_recorded_once(trained, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    run = only_run(trained)
    for _ in range(2):
        record_training(run.path, run.read_config())
    assert len((tmp_path / "parking_exp" / "trained_here").read_text().splitlines()) == 1


@pytest.mark.parametrize("state", ["relative", "", "/proc/nowhere"])
def test_without_a_state_directory_there_is_no_record_and_training_goes_on(
    trained, state, tmp_path, monkeypatch
):
    monkeypatch.setenv("XDG_STATE_HOME", state)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)  # as for a user without a home
    monkeypatch.chdir(tmp_path)
    run = only_run(trained)
    record_training(run.path, run.read_config())
    assert not was_trained_here(run.path)
    assert list(tmp_path.iterdir()) == []
