"""Goal environments as people write them, to the exact step and number; `test_quirky_environments`
has the commands.
"""

from pathlib import Path

import numpy as np
import pytest
import torch
from support.runs import ROOT, in_memory, make_config, only_run, run_script
from support.user_policies import FunctionPolicy

from parking_exp.algorithms.build_model import build_model
from parking_exp.errors import ConfigError, FailedRunError
from parking_exp.evaluation.video import record_video
from parking_exp.runs.directory import RunDirectory
from parking_exp.sweeps.single_run import train
from parking_exp.tasks.gymnasium_env import GymnasiumReward
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.training_envs import make_training_envs
from parking_exp.training.seeds import derive_seeds

PLANE = "support.plane_tasks:"
SHORT = (
    "env=gymnasium",
    "total_timesteps=300",
    "n_envs=1",
    "algorithm.learning_starts=100",
    "algorithm.net_arch=[8]",
    "algorithm.batch_size=16",
    "evaluation.n_scenes=5",
    "evaluation.final_n_scenes=5",
    "tracking.mlflow=false",
)


def config(name, *overrides):
    return make_config(*SHORT, f"env.id={PLANE}{name}-v0", *overrides)


def trained(name, folder, *overrides):
    """The run directory of a training."""
    run = config(name, f"output_dir={folder}", *overrides)
    train(run)
    return RunDirectory(run.run_dir)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("ChangingFrames", "no video of support.plane_tasks:ChangingFrames-v0: ValueError: "),
        ("RenderExit", "no video of support.plane_tasks:RenderExit-v0: SystemExit: 3"),
    ],
)
def test_a_run_whose_environment_cannot_be_rendered_is_done_and_says_why_there_is_no_video(
    name, reason, capsys
):
    with in_memory() as folder:
        directory = trained(name, folder)
        assert directory.status == "done"
        (line,) = [line for line in capsys.readouterr().err.splitlines() if "video" in line]
        assert line.startswith(reason)
        assert not list(directory.path.glob("*video*"))
        assert not list(directory.path.glob(".tmp-*"))


def test_a_video_of_an_evaluation_that_cannot_be_made_is_one_sentence(tmp_path):
    task = make_task(config("LateRenderError").env)
    path = tmp_path / "video.mp4"
    wait = FunctionPolicy(lambda observation: np.zeros((1, 2)))
    reason = record_video(wait, task, [0], path, gif=True)
    assert reason == f"no video of {task.env_id}: RuntimeError: GL context lost"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["InfoArray", "ColumnReward"])
def test_rewards_of_any_shape_that_stable_baselines3_takes_train(name):
    with in_memory() as folder:
        assert trained(name, folder).result().steps == 300


@pytest.mark.parametrize(
    ("name", "overrides", "step", "what"),
    [
        ("NotFinite", [], 150, "observation"),
        ("NotFinite", ["+env.kwargs.part=achieved_goal"], 150, "achieved_goal"),
        ("NotFinite", ["+env.kwargs.part=reward"], 150, "reward"),
        ("LastNotFinite", [], 160, "observation"),
        ("ReachPlane", ["algorithm.learning_rate=1e25"], 104, "train/critic_loss"),
    ],
)
def test_what_is_not_finite_fails_the_run_and_the_step_is_named(name, overrides, step, what):
    with in_memory() as folder:
        with pytest.raises(FailedRunError, match=f"{what} is not finite at step {step};"):
            trained(name, folder, *overrides)
        assert only_run(Path(folder)).status == "failed"


def test_an_evaluation_that_is_not_finite_fails_the_run_at_its_step():
    """After 60 steps of the check and 102 of training, an instance reaches its 150th step in the
    evaluation only.
    """
    run = ["total_timesteps=102", "evaluation.final_n_scenes=40"]
    with (
        in_memory() as folder,
        pytest.raises(FailedRunError, match="evaluation at step 102: observation is not finite"),
    ):
        trained("NotFinite", folder, *run)


def test_a_reward_that_ignores_what_was_achieved_is_refused():
    with pytest.raises(ConfigError, match="compute_reward ignores its achieved_goal"):
        config("OwnPosition")


@pytest.mark.parametrize("name", ["AlwaysThere", "NeverThere"])
def test_rewards_that_happen_to_be_equal_along_random_steps_are_accepted(name):
    assert config(name).env.id == f"{PLANE}{name}-v0"


def test_infos_are_an_array_only_where_compute_reward_takes_no_list():
    goals = np.zeros((2, 2), np.float32)
    reward = GymnasiumReward(config("InfoArray").env)
    at_wall = [[name == "at_wall" and value for name in reward.info_keys] for value in (0.0, 1.0)]
    assert reward(goals, goals, np.array(at_wall))[0].tolist() == [0.0, -5.0]
    away = np.array([[0.0, 0.0], [1.0, 0.0]])
    assert GymnasiumReward(config("ReachPlane").env)(goals, away)[0].tolist() == [0.0, -1.0]


def test_seeds_of_parking_stay_what_they_were_since_published_policies_depend_on_them():
    seeds = derive_seeds(0, make_config().env.training_seeds)
    assert seeds.training_envs == 3677149159


def test_further_entries_of_an_observation_are_normalised_and_used():
    """The entry is called `goal`, like the statistics of goals."""
    run = config("Signed")
    task = make_task(run.env)
    model = build_model(run, task, make_training_envs(task, 1), seed=0)
    extractor = model.actor.features_extractor
    normalizer = extractor.normalizer
    sizes = {"observation": 2, "achieved_goal": 2, "desired_goal": 2, "goal": 1}
    zeros = {key: np.zeros((2, size), np.float32) for key, size in sizes.items()}
    normalizer.update({**zeros, "goal": np.array([[3.0], [5.0]])})
    features = extractor(
        {
            key: torch.as_tensor(value)
            for key, value in {**zeros, "goal": np.full((2, 1), 5.5)}.items()
        }
    )
    assert features.tolist() == [[0.0] * 6 + [1.5]] * 2


@pytest.mark.slow
def test_a_policy_that_needs_a_further_entry_is_learned():
    with in_memory() as folder:
        overrides = [
            "total_timesteps=3000",
            "n_envs=2",
            "algorithm.learning_starts=200",
            "algorithm.net_arch=[32,32]",
        ]
        directory = trained(
            "Signed", folder, *overrides, "algorithm.batch_size=256", "evaluation.final_n_scenes=20"
        )
        assert directory.result().metrics["final/success_rate"] >= 0.9


def test_evaluate_refuses_seeds_of_training_of_the_task(tmp_path):
    directory = trained("ReachPlane", tmp_path, "evaluation.video_episodes=0")
    arguments = [f"run={directory.path}", f"output_dir={tmp_path}", "trust=true", "episodes=2"]
    environment = {"PYTHONPATH": str(ROOT / "tests")}
    done = run_script("evaluate", *arguments, "first_scene=1073741823", env=environment)
    assert (
        "first_scene=1073741823 overlaps the training seeds; it can be at most 1073741822"
        in done.stderr
    )
