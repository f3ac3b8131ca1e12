"""Runs of a policy that is not trained: from the command to the result, killed, evaluated again."""

import json
import os
import zipfile
from importlib.metadata import version

import pandas as pd
import pytest
from support.runs import call_script, only_run, refusal, store
from support.sweep_processes import begin, wait_until

from parking_exp import load_model
from parking_exp.config.compose import compose
from parking_exp.config.rules import update_ratio_warning
from parking_exp.errors import ConfigError, ModelError
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.run_files import CONFIG_FILE
from parking_exp.statistics import wilson_interval
from parking_exp.training.scripted_session import ScriptedSession

PLANNER = (
    "env=parking_parallel",
    "algorithm=planner",
    "evaluation.n_scenes=2",
    "evaluation.final_n_scenes=6",
    "evaluation.n_certified_scenes=1",
    "evaluation.video_episodes=0",
)


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """The output directory of a finished run of the planner, and what it printed."""
    output_dir = tmp_path_factory.mktemp("planned")
    done = call_script("train", *PLANNER, f"output_dir={output_dir}", code=0)
    return output_dir, done


def episodes(output_dir):
    """The episodes of a run without what a clock says."""
    return pd.read_csv(only_run(output_dir).path / "episodes.csv").drop(columns="plan_s")


def test_a_run_of_the_planner_has_its_episodes_its_metrics_and_no_env_steps(planned):
    output_dir, done = planned
    assert "parked   100.0%" in done.stdout
    assert "after 0 env steps" in done.stdout
    directory = only_run(output_dir)
    table = pd.read_csv(directory.path / "episodes.csv")
    assert table["phase"].value_counts().to_dict() == {"final": 6, "eval": 2, "certified": 1}
    assert set(table["step"]) == {0}
    assert set(table["outcome"]) == {"success"}
    assert (table["plan_s"] > 0).all()
    assert directory.read_config().total_timesteps == 0
    assert directory.read_result().steps == 0
    stored = store(output_dir).get_run(directory.run_id).data
    final = table[table["phase"] == "final"]
    assert stored.metrics["final/plan_s_mean"] == pytest.approx(final["plan_s"].mean())
    assert stored.tags["version.ompl"] == version("ompl")


def test_a_clock_before_1980_keeps_no_policy_from_being_saved(tmp_path):
    config_file = tmp_path / CONFIG_FILE
    config_file.write_text("name: planner")
    os.utime(config_file, (0, 0))
    session = ScriptedSession.__new__(ScriptedSession)
    session.directory = RunDirectory(tmp_path)
    session.save_final(tmp_path / "final.zip")
    with zipfile.ZipFile(tmp_path / "final.zip") as archive:
        assert archive.read(CONFIG_FILE) == b"name: planner"


def test_a_run_that_is_killed_while_it_plans_ends_as_if_it_had_not_been(planned, tmp_path):
    process = begin(tmp_path, options=PLANNER)

    def is_evaluating():
        beats = list(tmp_path.glob("*/*/seed=*/beat.json"))
        return beats and "final evaluation" in json.loads(beats[0].read_text())["doing"]

    wait_until(is_evaluating)
    process.kill()
    process.wait()
    assert only_run(tmp_path).status == "running"
    call_script("train", *PLANNER, f"output_dir={tmp_path}", code=0)
    pd.testing.assert_frame_equal(episodes(tmp_path), episodes(planned[0]))


def test_a_finished_run_is_evaluated_on_the_same_episodes_with_a_replay_and_a_video(planned):
    output_dir, _ = planned
    arguments = ("run=latest", "episodes=6", "video=1", "replay=true", "simulator=vectorized")
    call_script("evaluate", *arguments, f"output_dir={output_dir}", code=0)
    folder = only_run(output_dir).path / "evaluations/parking_parallel-final-seeds-0-5-vectorized"
    assert (folder / "replay.html").stat().st_size > 10_000
    assert (folder / "video.mp4").stat().st_size > 10_000
    evaluated = pd.read_csv(folder / "episodes.csv").drop(columns="plan_s")
    final = episodes(output_dir).query("phase == 'final'").reset_index(drop=True)
    pd.testing.assert_frame_equal(evaluated, final.drop(columns=["phase", "step"]))


def test_an_evaluation_where_it_cannot_drive_is_refused_with_a_sentence(planned):
    output_dir, _ = planned
    options = (f"run={only_run(output_dir).path}", "env.action.speed_range=[0,5]")
    sentence = "the planner needs an env.action.speed_range of both directions"
    assert refusal("evaluate", *options) == sentence


def test_a_report_has_the_interval_of_the_episodes_and_says_what_the_planner_knows(planned):
    output_dir, _ = planned
    call_script("report", f"output_dir={output_dir}", "report=quick", code=0)
    folder = output_dir / "reports" / "parking"
    (cell,) = json.loads((folder / "report.json").read_text())["cells"]
    low, high = wilson_interval(6, 6)
    assert cell["success"] == {"value": 1.0, "low": low, "high": high, "n": 1}
    assert cell["total_timesteps"] == 0
    assert cell["label"] == "planner"
    assert "knows the map of each scene" in (folder / "index.html").read_text()


def test_the_planner_has_no_model_to_load(planned):
    with pytest.raises(ModelError) as error:
        load_model("latest", planned[0])
    assert str(error.value).startswith("algorithm=planner is not trained, so it has no model; ")


def test_keys_of_training_have_no_effect_on_what_is_not_trained():
    plain = compose("env=parking_parallel", "algorithm=planner")
    for override in (
        "total_timesteps=5000",
        "init=pretrained/default",
        "algorithm.gamma=0.9",
        "algorithm.net_arch=[8]",
        "algorithm.features=ego",
        "++algorithm.policy_delay=3",
    ):
        config = compose("env=parking_parallel", "algorithm=planner", override)
        assert config.run_key == plain.run_key, override
    assert compose("algorithm=planner", "experiment=smoke").algorithm == plain.algorithm
    assert update_ratio_warning(compose("algorithm=planner", "n_envs=1")) is None


def test_what_is_trained_needs_env_steps():
    assert compose("algorithm=sac").total_timesteps == 256_000
    with pytest.raises(ConfigError, match="total_timesteps=0: algorithm=sac is trained; give at"):
        compose("algorithm=sac", "buffer=replay", "total_timesteps=0")
