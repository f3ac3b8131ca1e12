"""A finished run with other settings of its final evaluation is only evaluated again."""

import shutil

import pandas as pd
import pytest
from support.run_equality import differences
from support.runs import call_script, only_run, refusal, store
from support.sweep_processes import sweep

from parking_exp.config.compose import compose
from parking_exp.runs.metric_logs import restore_logs
from parking_exp.runs.run_provenance import PROVENANCE_FILE
from parking_exp.sweeps.single_run import train

SMOKE = ("experiment=smoke", "total_timesteps=100", "tracking.tensorboard=false")
OTHER = (
    "evaluation.final_n_scenes=7",
    "evaluation.n_certified_scenes=2",
    "evaluation.video_episodes=0",
)


@pytest.fixture(scope="module")
def trained(empty, tmp_path_factory):
    """Output directories of a run with the first and with the other settings."""
    folder = tmp_path_factory.mktemp("trained")
    for name, settings in (("first", ()), ("other", OTHER)):
        (folder / name).mkdir()
        shutil.copy(empty / "mlflow.db", folder / name)
        train(compose(*SMOKE, *settings, f"output_dir={folder / name}"))
    return folder


@pytest.fixture
def finished(trained, tmp_path):
    """The run with the first settings, in a copy of its output directory."""
    return only_run(shutil.copytree(trained / "first", tmp_path / "outputs"))


def train_again(directory, *overrides):
    """Train a finished run with other settings."""
    return train(compose(*SMOKE, *overrides, f"output_dir={directory.output_dir}"))


def final_runs(directory):
    """Number of episodes and final return of the runs that the store of a run shows."""
    runs = store(directory.output_dir).search_runs(["1"])
    return [
        (run.data.params["evaluation.final_n_scenes"], run.data.metrics["final/return_mean"])
        for run in runs
    ]


def test_it_ends_as_a_run_that_had_these_settings_from_the_start(finished, trained):
    assert (finished.path / "video.mp4").exists()
    result = train_again(finished, *OTHER)
    reference = only_run(trained / "other")
    assert differences(finished.path, reference.path) == []
    expected = reference.read_result().metrics["final/return_mean"]
    assert result.metrics["final/return_mean"] == expected
    assert not (finished.path / "video.mp4").exists()
    assert finished.read_config().evaluation == reference.read_config().evaluation
    assert final_runs(finished) == [("7", result.metrics["final/return_mean"])]
    assert finished.run_id == result.run_id


def test_settings_without_effect_evaluate_nothing(finished, capsys):
    n_scenes = finished.read_config().evaluation.final_n_scenes  # all of which are cross-checked
    before = (finished.path / "episodes.csv").stat().st_mtime_ns
    for setting in (
        "checkpoint.keep_last=5",
        f"evaluation.n_certified_scenes={n_scenes}",
        f"evaluation.n_certified_scenes={n_scenes + 1}",
    ):
        train_again(finished, setting)
        assert capsys.readouterr().out.startswith("already done; ")
    assert (finished.path / "episodes.csv").stat().st_mtime_ns == before


def killed_before_it_is_reopened(directory):
    (directory.path / PROVENANCE_FILE).unlink()


def killed_when_it_was_reopened(directory):
    directory.reopen()


def killed_in_the_final_evaluation(directory):
    directory.reopen()
    (checkpoint,) = directory.checkpoints.glob("step=0000000100")
    restore_logs(directory.path, checkpoint)
    (directory.path / "episodes.csv").open("a").write("final,100,0,")
    directory.update_status(status="running")


@pytest.mark.parametrize(
    "kill",
    [killed_before_it_is_reopened, killed_when_it_was_reopened, killed_in_the_final_evaluation],
)
def test_after_a_kill_the_same_command_ends_in_the_same_state(finished, trained, kill):
    kill(finished)
    result = train_again(finished, *OTHER)
    assert differences(finished.path, only_run(trained / "other").path) == []
    assert final_runs(finished) == [("7", result.metrics["final/return_mean"])]


def delete_checkpoint(directory):
    shutil.rmtree(directory.checkpoints)


def damage_checkpoint(directory):
    (directory.checkpoints / "step=0000000100" / "model.zip").write_bytes(b"")


@pytest.mark.parametrize(
    ("damage", "problem"),
    [
        (delete_checkpoint, "manifest.json is missing or damaged in "),
        (damage_checkpoint, "model.zip is missing or damaged in "),
    ],
)
def test_without_its_last_checkpoint_its_results_are_kept(finished, damage, problem):
    damage(finished)
    files = [finished.path / name for name in ("episodes.csv", "config.yaml")]
    before = [file.read_bytes() for file in files]
    for arguments in ((), ("retry=failed",)):  # a single run, and a sweep
        command = ("train", *SMOKE, *OTHER, f"output_dir={finished.output_dir}")
        done = call_script(*command, *arguments, code=0)
        assert (
            f"it can't be evaluated again with other settings, since {problem}{finished.path}"
            in done.stdout
        )
        assert (
            f"`python scripts/evaluate.py run={finished.path}` evaluates its final model"
            in done.stdout
        )
    assert [file.read_bytes() for file in files] == before
    assert finished.status == "done"


def test_a_sweep_says_how_many_runs_it_evaluates_again_and_trains_none(tmp_path):
    sweep(tmp_path, "seeds=2")
    models = [*tmp_path.glob("*/*/seed=*/checkpoints/*/model.zip")]
    times = [model.stat().st_mtime_ns for model in models]
    plan = sweep(tmp_path, "seeds=3", "evaluation.final_n_scenes=4", "dry_run=true")
    assert "3 runs, 3 to run, 2 of them for another evaluation only\n" in plan.stdout
    head, row = (line.split() for line in plan.stdout.splitlines()[:2])
    assert head == ["cell", "done", "running", "failed", "pending", "success"]
    assert row[-1] == "3"  # pending ones
    sweep(tmp_path, "seeds=2", "evaluation.final_n_scenes=4")
    assert [*tmp_path.glob("*/*/seed=*/checkpoints/*/model.zip")] == models
    assert [model.stat().st_mtime_ns for model in models] == times
    for file in tmp_path.glob("*/*/seed=*/episodes.csv"):
        assert len(pd.read_csv(file).query("phase == 'final'")) == 4
    assert (
        "2 runs, 0 to run\n"
        in sweep(tmp_path, "seeds=2", "evaluation.final_n_scenes=4", "dry_run=true").stdout
    )


def test_two_final_evaluations_of_the_same_runs_are_refused(tmp_path):
    scenes = "evaluation.final_n_scenes=5,6"
    sentence = refusal("train", *SMOKE, f"output_dir={tmp_path}", scenes)
    assert sentence.startswith(f"{scenes}: the same runs can't have both; ")
    assert list(tmp_path.iterdir()) == []
