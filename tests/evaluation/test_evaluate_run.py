"""The command evaluate.py: what it prints, writes, stores and refuses."""

import os
import re
import shutil
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf
from PIL import Image, ImageSequence
from support.runs import artifacts, call_script, evaluate_stored, refusal, store

from parking_exp import compose, train
from parking_exp.config.compose import compose_configs
from parking_exp.errors import ModelError, RunNotFoundError
from parking_exp.evaluation.agents import find_agent
from parking_exp.evaluation.evaluation_request import choose_env, validate_evaluation
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.foreign_files import read_json
from parking_exp.tasks.metrics import episode_columns
from parking_exp.tasks.parking.parking_metrics import METRICS
from parking_exp.tasks.parking.parking_task import ParkingTask
from parking_exp.tasks.registry import make_task


def test_episodes_rates_and_a_video_are_printed_and_stored(smoke_copy):
    output_dir = smoke_copy.output_dir
    done = call_script(
        "evaluate",
        f"run={smoke_copy.run_id}",
        f"output_dir={output_dir}",
        "episodes=6",
        "video=1",
        "gif=true",
        "replay=true",
        code=0,
    )
    copied = "is made again"  # the store, of a copied output directory
    assert [line for line in done.stderr.splitlines() if copied not in line] == []
    for name in ("success", "crash", "timeout", "parked"):
        assert re.search(rf"^{name} +\d+\.\d%   95 % interval", done.stdout, re.MULTILINE)
    folder = smoke_copy.path / "evaluations" / "parking-final-seeds-0-5"
    assert f"results        {folder}" in done.stdout
    assert f"replay         {folder / 'replay.html'}" in done.stdout
    page = (folder / "replay.html").read_text()
    assert "<title>final model on 6 episodes of parking – parking replay</title>" in page  # noqa: RUF001
    table = pd.read_csv(folder / "episodes.csv")
    assert table["scene"].tolist() == [0, 1, 2, 3, 4, 5]
    # Its start, three simulation frames a step, and a second of its end at 15 frames a second.
    frames = 1 + 3 * table["steps"][0] + 15
    video = iio.imread(folder / "video.mp4", plugin="FFMPEG")
    assert video.shape == (frames, 300, 600, 3)
    assert len(np.unique(video[:16], axis=0)) > 10  # the car moves, also between two policy steps
    with Image.open(folder / "video.gif") as gif:  # frames that repeat are shown longer instead
        shown_ms = sum(frame.info["duration"] for frame in ImageSequence.Iterator(gif))
    assert shown_ms == 200 * -(-frames // 3)
    stored = artifacts(store(output_dir), smoke_copy.run_id, f"evaluations/{folder.name}")
    assert [path.rpartition("/")[2] for path in stored] == [
        "episodes.csv",
        "replay.html",
        "summary.json",
        "video.gif",
        "video.mp4",
    ]
    # The same model on the same scenes: what the run itself saw at its end.
    final = (
        pd.read_csv(smoke_copy.path / "episodes.csv")
        .query("phase == 'final'")
        .reset_index(drop=True)
    )
    pd.testing.assert_frame_equal(table.head(5), final[episode_columns(METRICS)], rtol=1e-6)


def test_another_env_the_best_model_and_a_name_can_be_chosen_and_earlier_files_go(smoke_copy):
    arguments = (f"run={smoke_copy.path}", "episodes=2", "env=parking_crowded", "env.duration=0.4",
                 "model=best", "tracking.mlflow=false", "name=crowded")  # fmt: skip
    for seen in (["video=1", "replay=true"], []):
        done = call_script("evaluate", *arguments, *seen, code=0)
    assert "best model on 2 episodes of parking_crowded" in done.stdout
    folder = smoke_copy.path / "evaluations" / "crowded"
    assert {path.name for path in folder.iterdir()} == {"episodes.csv", "summary.json"}
    assert len(pd.read_csv(folder / "episodes.csv")) == 2


def test_a_folder_of_runs_is_evaluated_on_changes_of_the_env_of_training_with_a_table(smoke_copy):
    output_dir = smoke_copy.output_dir
    twin = smoke_copy.path.with_name("seed=8")
    shutil.copytree(smoke_copy.path, twin)
    arguments = (
        f"run={smoke_copy.path.parents[1]}",
        f"output_dir={output_dir}",
        "episodes=3",
        "simulator=vectorized",
        "tracking.mlflow=false",
        "env.vehicles_count=0,20",
    )
    done = call_script("evaluate", *arguments, code=0)
    table = [line.split() for line in done.stdout.splitlines()[-2:]]
    assert [row[-6] for row in table] == ["2", "2"]  # runs
    assert [row[-7] for row in table] == ["vehicles_count=0", "vehicles_count=20"]
    summaries = [read_json(path) for path in (twin / "evaluations").glob("*/summary.json")]
    assert {summary["env_config"]["vehicles_count"] for summary in summaries} == {0, 20}
    assert "3 episodes of parking (vehicles_count=20), from seed 0" in done.stdout
    done = call_script("evaluate", *arguments[:-1], "env.vehicles_count=20")
    (*_, row) = done.stdout.splitlines()
    assert row.split()[-7] == "vehicles_count=20"  # named, where it is the only one
    assert "name" in refusal("evaluate", *arguments, "name=same")
    RunDirectory(twin).update_status(status="failed")
    done = call_script("evaluate", *arguments[:-1])
    assert "1 unfinished run" in done.stdout
    RunDirectory(smoke_copy.path).update_status(status="running")
    assert "none of its 2 runs is finished" in refusal("evaluate", *arguments)


def test_an_env_is_checked_once_for_all_its_agents(smoke_copy, monkeypatch):
    output_dir = smoke_copy.output_dir
    shutil.copytree(smoke_copy.path, smoke_copy.path.with_name("seed=8"))
    checked = []

    def problems(task):
        checked.append(task.config.vehicles_count)
        return ["env is wrong"] if task.config.vehicles_count == 20 else []

    monkeypatch.setattr(ParkingTask, "problems", problems)
    options = [f"output_dir={output_dir}", "episodes=3", "env.vehicles_count=0,20"]
    assert refusal("evaluate", f"run={smoke_copy.path.parents[1]}", *options) == "env is wrong"
    assert checked == [0, 20]
    assert not (smoke_copy.path / "evaluations").exists()


def test_an_agent_keeps_its_observation_on_another_option_of_env(smoke_copy):
    config = OmegaConf.load(smoke_copy.path / "config.yaml")
    OmegaConf.update(config, "env.observation.vehicles_count", 4)
    OmegaConf.save(config, smoke_copy.path / "config.yaml")
    (request,) = (
        validate_evaluation(config)
        for config in compose_configs("evaluate", ["env=parking_crowded"])
    )
    env = choose_env(request, find_agent(str(smoke_copy.path), smoke_copy.output_dir))
    assert (env.name, env.vehicles_count) == ("parking_crowded", 10)
    assert env.observation.vehicles_count == 4


@pytest.fixture(scope="module")
def parked_in_parallel(tmp_path_factory):
    """The directory of a short run on parallel slots, whose level is easy."""
    output = tmp_path_factory.mktemp("parallel")
    overrides = ["env=parking_parallel", "algorithm.features=ego_mirrored", "env.duration=20"]
    result = train(compose("experiment=smoke", *overrides, f"output_dir={output}"))
    return Path(result.run_dir)


@pytest.mark.parametrize("other", ["env.lot.slot_length_m=6", "env.lot.angle_deg=30"])
def test_an_agent_keeps_its_features_on_another_lot(parked_in_parallel, other):
    """Also where the other lot has another length and other symmetries."""
    agent = find_agent(str(parked_in_parallel), parked_in_parallel.parents[2])
    (config,) = compose_configs("evaluate", [f"run={parked_in_parallel}", f"++{other}"])
    task = make_task(choose_env(validate_evaluation(config), agent))
    extractor = agent.load(task).policy.actor.features_extractor
    assert extractor.lot_size_m == (81.0, 22.0)
    task.close()


def test_a_level_of_a_stored_run_needs_its_env(parked_in_parallel):
    assert refusal("evaluate", f"run={parked_in_parallel}", "env.level=hard", "episodes=2") == (
        "env.level=hard: a run keeps the numbers of its own level only; add env=parking_parallel"
    )


def test_a_model_that_does_not_fit_its_config_or_is_damaged_or_missing_is_named(smoke_copy):
    path = smoke_copy.models / "final.zip"
    config = OmegaConf.load(smoke_copy.path / "config.yaml")
    OmegaConf.update(config, "algorithm.net_arch", [8, 8])
    OmegaConf.save(config, smoke_copy.path / "config.yaml")
    with pytest.raises(ModelError, match=rf"^{path} .*config\.yaml") as refusal:
        evaluate_stored(smoke_copy.path)
    assert "\n" not in str(refusal.value)
    os.truncate(path, 3000)
    with pytest.raises(ModelError, match=rf"^{path} is damaged"):
        evaluate_stored(smoke_copy.path)
    path.unlink()
    with pytest.raises(RunNotFoundError, match=str(path)):
        evaluate_stored(smoke_copy.path)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["epsodes=3"], "epsodes"),
        (["episodes=0"], "episodes=0"),
        (["episodes=3", "video=5"], "video=5"),
        (["gif=true"], "gif=true"),
        (["first_scene=2147483600"], "first_scene=2147483600"),
        (["env.durtion=2"], "env.durtion"),
        (["env.observation.vehicles_count=4"], "env.observation.vehicles_count=4"),
        (["env.simulator=vectorized"], "simulator=vectorized"),
        (["env.task=gymnasium"], "env.task=gymnasium"),
        (["env={duration: 3}"], "env={duration: 3}"),
        (["env=fetch_reach"], "env=fetch_reach"),
        (["seeds=3"], "seeds=3"),
        (["env=parking", "env.policy_frequency=20"], "env.policy_frequency=20"),
        (["algorithm=td3"], "algorithm"),
    ],
)
def test_a_mistake_is_one_sentence_that_names_the_key(smoke, arguments, named):
    assert named in refusal("evaluate", f"output_dir={smoke.output_dir}", *arguments)


@pytest.mark.parametrize(
    ("run", "n_scenes"), [("latest", 100), ("pretrained", 20), ("pretrained/parked", 20)]
)
def test_a_pretrained_agent_is_evaluated_on_20_scenes_and_a_run_on_100_by_default(run, n_scenes):
    for arguments, expected in (
        (["first_scene=3"], range(3, 3 + n_scenes)),
        (["episodes=7"], range(7)),
    ):
        (config,) = compose_configs("evaluate", [f"run={run}", *arguments])
        assert validate_evaluation(config).seeds == expected


def test_two_evaluations_with_one_name_are_refused_before_anything_is_written(tmp_path):
    arguments = ("run=pretrained", "episodes=1,2", "name=mine")
    assert refusal("evaluate", *arguments, cwd=tmp_path) == (
        "two of these evaluations would share a folder; leave name out, and name each run once"
    )
    assert list(tmp_path.iterdir()) == []
