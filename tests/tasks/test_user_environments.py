"""Goal environments as people write them, with quirks that were reported to public projects: they
train, or the run says why not.
"""

import numpy as np
import pytest
import torch
from support import toy_tasks
from support.models import model_of
from support.runs import ROOT, call_script, config_refusal, only_run, refusal, run_code

from parking_exp.config.compose import compose
from parking_exp.tasks.registry import make_task
from parking_exp.training.seeds import derive_seeds

TOY = "support.toy_tasks:"
SHORT = (
    "env=gymnasium",
    "total_timesteps=300",
    "n_envs=1",
    "algorithm.learning_starts=100",
    "algorithm.net_arch=[8]",
    "algorithm.batch_size=16",
    "evaluation.every_n_steps=null",
    "evaluation.n_scenes=2",
    "evaluation.final_n_scenes=3",
    "evaluation.video_episodes=0",
    "checkpoint.every_n_steps=null",
    "tracking.mlflow=false",
    "tracking.tensorboard=false",
)


def config(name, *overrides):
    return compose(*SHORT, f"env.id={TOY}{name}-v0", *overrides)


def train(output_dir, name, *overrides, code=0):
    arguments = [*SHORT, f"env.id={TOY}{name}-v0", f"output_dir={output_dir}", *overrides]
    return call_script("train", *arguments, code=code)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("Blank", "no video: the environment renders NoneType instead of an array"),
        ("LosesContext", f"no video of {TOY}LosesContext-v0: RuntimeError: GL context lost"),
        ("ChangingFrames", f"no video of {TOY}ChangingFrames-v0: ValueError: "),
        ("RenderExit", f"no video of {TOY}RenderExit-v0: SystemExit: 3"),
    ],
)
def test_a_run_whose_env_cannot_be_rendered_is_done_without_a_video(tmp_path, name, reason):
    done = train(tmp_path, name, "evaluation.video_episodes=1")
    (line,) = [line for line in done.stderr.splitlines() if "video" in line]
    assert line.startswith(reason)
    directory = only_run(tmp_path)
    assert directory.status == "done"
    arguments = (f"run={directory.path}", f"output_dir={tmp_path}", "episodes=1", "trust=true")
    evaluated = call_script("evaluate", *arguments, "video=1", "gif=true", code=0)
    assert reason in evaluated.stdout
    assert list(tmp_path.rglob("*video*")) == []
    assert list(tmp_path.rglob(".tmp-*")) == []


@pytest.mark.parametrize(
    "name", ["CloseFails", "Wrapped", "SmallSeeds", "InfoArray", "ColumnReward"]
)
def test_what_stable_baselines3_trains_is_trained(tmp_path, name):
    train(tmp_path, name)
    assert only_run(tmp_path).read_result().steps == 300


@pytest.mark.parametrize(
    ("name", "overrides", "step", "what"),
    [
        ("NotFinite", [], 150, "observation"),
        ("NotFinite", ["+env.kwargs.part=achieved_goal"], 150, "achieved_goal"),
        ("NotFinite", ["+env.kwargs.part=reward"], 150, "reward"),
        ("LastNotFinite", [], 160, "observation"),
        ("Plane", ["algorithm.learning_rate=1e25"], 104, "train/critic_loss"),
    ],
)
def test_what_is_not_finite_fails_the_run_and_the_step_is_named(
    tmp_path, name, overrides, step, what
):
    failed = train(tmp_path, name, *overrides, code=2)
    assert f"{what} is not finite at step {step};" in failed.stderr
    assert only_run(tmp_path).status == "failed"


def test_an_evaluation_that_is_not_finite_fails_the_run_at_its_step(tmp_path):
    """After 60 steps of the check and 102 of training, an instance reaches its 150th step in the
    evaluation only.
    """
    options = ("total_timesteps=102", "evaluation.final_n_scenes=40")
    failed = train(tmp_path, "NotFinite", *options, code=2)
    assert "evaluation at step 102: observation is not finite" in failed.stderr


@pytest.mark.parametrize("name", ["AlwaysThere", "NeverThere"])
def test_rewards_that_happen_to_be_equal_along_random_steps_are_accepted(name):
    assert config(name).env.id == f"{TOY}{name}-v0"


def test_seeds_of_training_fit_31_bits_and_are_no_seeds_of_evaluations(tmp_path):
    training = config("SmallSeeds").env.training_seeds
    assert (training.start, training.stop) == (2**30, 2**31 - 100_000)
    assert derive_seeds(0, training).training_envs in training
    overlap = config_refusal(
        *SHORT, f"env.id={TOY}SmallSeeds-v0", f"evaluation.first_scene={2**30 - 2}"
    )
    assert overlap.startswith("evaluation.first_scene=1073741822 overlaps the training seeds")

    train(tmp_path, "SmallSeeds")
    arguments = (f"run={only_run(tmp_path).path}", f"output_dir={tmp_path}", "trust=true")
    overlap = refusal("evaluate", *arguments, "episodes=2", "first_scene=1073741823")
    sentence = "first_scene=1073741823 overlaps the training seeds; it can be at most 1073741822"
    assert overlap.startswith(sentence)


def test_further_entries_of_an_observation_are_normalised_and_used():
    """The entry is called `goal`, like the statistics of goals."""
    extractor = model_of(config("Signed")).actor.features_extractor
    sizes = {"observation": 2, "achieved_goal": 2, "desired_goal": 2, "goal": 1}
    zeros = {key: np.zeros((2, size), np.float32) for key, size in sizes.items()}
    extractor.normalizer.update({**zeros, "goal": np.array([[3.0], [5.0]])})
    observation = {key: torch.as_tensor(value) for key, value in zeros.items()}
    observation["goal"] = torch.full((2, 1), 5.5)
    assert extractor(observation).tolist() == [[0.0] * 6 + [1.5]] * 2


@pytest.mark.slow
def test_a_policy_that_needs_a_further_entry_is_learned(tmp_path):
    train(
        tmp_path,
        "Signed",
        "total_timesteps=3000",
        "n_envs=2",
        "algorithm.learning_starts=200",
        "algorithm.net_arch=[32,32]",
        "algorithm.batch_size=256",
        "evaluation.final_n_scenes=20",
    )
    assert only_run(tmp_path).read_result().metrics["final/success_rate"] >= 0.9


def test_a_run_of_one_env_makes_few_instances_and_closes_them(tmp_path):
    toy_tasks.Counted.n_open = toy_tasks.Counted.n_most = 0
    train(tmp_path, "Counted", "evaluation.final_n_scenes=20", "evaluation.video_episodes=1")
    assert toy_tasks.Counted.n_most <= 8
    assert toy_tasks.Counted.n_open == 0


def test_an_env_of_a_notebook_trains_in_processes_of_its_own(tmp_path):
    own = ("env.id=Mine-v0", "env.vectorization=async", f"output_dir={tmp_path}")
    overrides = [*SHORT, *own]
    program = (
        "import gymnasium as gym\n"
        "from support.toy_tasks import BitFlip\n"
        "class Mine(BitFlip):\n"
        "    pass\n"
        "gym.register('Mine-v0', Mine, max_episode_steps=8)\n"
        "from parking_exp import compose, train\n"
        f"train(compose(*{overrides!r}))\n"
    )
    run_code(program, cwd=ROOT / "tests")
    assert only_run(tmp_path).status == "done"


def test_a_process_of_an_env_that_ends_is_reported_in_a_sentence(tmp_path):
    done = train(tmp_path, "Exits", "env.vectorization=async", code=2)
    assert "EnvProcessError: the process of an env has ended" in done.stderr
    assert "env.vectorization=sync needs no processes" in done.stderr


def test_a_task_has_the_metrics_of_its_own(tmp_path):
    train(tmp_path, "BitFlip")
    metrics = only_run(tmp_path).read_result().metrics
    rates = {name for name in metrics if name.startswith("final/") and name.endswith("_rate")}
    assert rates == {"final/success_rate", "final/failure_rate", "final/timeout_rate"}
    assert make_task(config("BitFlip").env).failure == "failure"
