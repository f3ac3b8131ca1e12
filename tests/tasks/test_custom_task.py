"""Tasks of other packages, named by the dotted path of their class."""

import shutil
import sys

import numpy as np
import pytest
from support.runs import call_script, only_run, refusal
from support.user_policies import constant
from support.user_tasks import Steps, write_option

from parking_exp.config.compose import compose
from parking_exp.errors import ConfigError
from parking_exp.evaluation.evaluate_policy import evaluate_policy
from parking_exp.results import load
from parking_exp.sweeps.single_run import train
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.training_envs import make_training_envs

SHORT = (
    "total_timesteps=200",
    "n_envs=4",
    "algorithm.learning_starts=100",
    "algorithm.net_arch=[8]",
    "evaluation.every_n_steps=null",
    "evaluation.final_n_scenes=20",
    "evaluation.n_scenes=4",
    "checkpoint.every_n_steps=100",
)


@pytest.fixture
def config_dir(tmp_path):
    return write_option(tmp_path / "my_conf", "support.user_tasks.Steps")


def test_episodes_end_at_the_goal_at_a_failure_or_in_time():
    task = Steps()
    columns = ["scene", "outcome", "steps", "return"]
    assert evaluate_policy(constant(1.0), task, [0, 1, 2, 3])[columns].to_numpy().tolist() == [
        [0, "success", 3, -3.0],
        [1, "success", 2, -1.0],
        [2, "success", 1, 0.0],
        [3, "timeout", 5, -15.0],
    ]
    assert evaluate_policy(constant(-1.0), task, [0, 3])[columns].to_numpy().tolist() == [
        [0, "failure", 2, -9.0],
        [3, "failure", 5, -15.0],
    ]


def test_training_envs_start_again_and_keep_what_they_have_shown():
    envs = make_training_envs(Steps(), 4)
    envs.seed(0)
    start = envs.reset()
    assert start["observation"].tolist() == [[0.0], [1.0], [2.0], [3.0]]
    observation, rewards, dones, infos = envs.step(np.ones((4, 1), np.float32))
    assert start["observation"].tolist() == [[0.0], [1.0], [2.0], [3.0]]
    assert start["desired_goal"].tolist() == [[3.0]] * 4
    assert rewards.tolist() == [-2.0, -1.0, 0.0, -1.0]
    assert dones.tolist() == [False, False, True, False]
    assert infos[2]["is_success"] is True
    assert infos[2]["is_failure"] is False
    assert infos[2]["terminal_observation"]["observation"].tolist() == [3.0]
    assert infos[2]["TimeLimit.truncated"] is False
    assert observation["observation"][:2].tolist() == [[1.0], [2.0]]


@pytest.mark.parametrize(
    ("name", "argument", "reason"),
    [
        (
            "support.user_tasks.Nothing",
            "name=steps",
            "AttributeError: .* has no attribute 'Nothing'",
        ),
        (
            "no_such_package.Task",
            "name=steps",
            "ModuleNotFoundError: No module named 'no_such_package'",
        ),
        (
            "support.user_tasks.Unknown",
            "name=steps",
            r"it is not a subclass of parking_exp\.tasks\.task\.Task",
        ),
        ("os.system", "name=steps", r"it is not a subclass of parking_exp\.tasks\.task\.Task"),
        (
            "support.user_tasks.Unfinished",
            "name=steps",
            "TypeError: Can't instantiate abstract class .*observe",
        ),
        (
            "support.user_tasks.OwnEnvs",
            "name=steps",
            "TypeError: Can't instantiate .*evaluation_batch",
        ),
        ("support.user_tasks.Steps", "kwargs.right_edge=2", "TypeError: .*'right_edge'"),
        ("support.user_tasks.Steps", "kwargs.left_edge=a", "UFuncNoLoopError|TypeError"),
        (
            "support.user_tasks.FlatReward",
            "name=steps",
            r"reward of two episodes has the shape \(\), not \(2,\)",
        ),
        ("support.user_tasks.NoGoal", "name=steps", "KeyError: 'achieved_goal'"),
    ],
)
def test_a_class_that_is_no_task_is_refused_in_a_sentence(name, argument, reason, config_dir):
    overrides = ("env=steps", f"env.task={name}", f"++env.{argument}")
    with pytest.raises(ConfigError, match=rf"^env\.task[=:].*({reason})") as refusal:
        compose(*overrides, config_dir=config_dir)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("task", ["chess", "3", "a.", ".a", "a b.c", "null"])
def test_what_names_no_task_is_refused(task):
    with pytest.raises(ConfigError, match=r"^env\.task: it is neither 'parking', 'gymnasium' nor"):
        compose(f"++env.task={task}")


def test_a_run_is_trained_evaluated_and_read(config_dir, output_dir):
    overrides = ("env=steps", *SHORT, f"output_dir={output_dir}")
    config = compose(*overrides, config_dir=config_dir)
    assert train(config).steps == 200
    directory = only_run(output_dir)
    assert directory.path.parent.name.startswith("steps-td3-her_future-")

    episodes = load("steps", output_dir=output_dir).episodes
    assert set(episodes["outcome"]) <= {"success", "failure", "timeout"}
    assert len(episodes.query("phase == 'final'")) == 20

    arguments = ("episodes=4", "tracking.mlflow=false", f"output_dir={output_dir}")
    done = call_script("evaluate", f"run={directory.path}", *arguments, code=0)
    assert "4 episodes of steps, from seed 0" in done.stdout


def test_the_class_of_a_run_from_elsewhere_is_not_imported(config_dir, output_dir, tmp_path):
    module = tmp_path / "modules" / "planted_task.py"
    module.parent.mkdir()
    text = "from support.user_tasks import Steps as Planted\n"
    module.write_text(text)
    trace = tmp_path / "imported"
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(module.parent)
        overrides = ("env=steps", "env.task=planted_task.Planted", *SHORT)
        train(compose(*overrides, f"output_dir={output_dir}", config_dir=config_dir))
        sys.modules.pop("planted_task")
        module.write_text(f"{text}open({str(trace)!r}, 'w')\n")
        copy = tmp_path / "outputs"
        shutil.copytree(output_dir, copy)
        run = only_run(copy).path

        command = ("evaluate", f"run={run}", f"output_dir={copy}", "episodes=2")
        sentence = refusal(*command)
        assert sentence.startswith("env.task=planted_task.Planted in")
        assert "trust=true (in Python trust=True) allows it" in sentence
        for name in ("status", "report"):
            call_script(name, "experiment=steps", f"output_dir={copy}", code=0)
        assert not trace.exists()
        call_script(*command, "trust=true", code=0)
        assert trace.exists()


def test_arguments_of_the_class_are_part_of_the_run(config_dir):
    edges = ("-1.0", "-2.0")
    configs = [
        compose("env=steps", f"+env.kwargs.left_edge={edge}", config_dir=config_dir)
        for edge in edges
    ]
    assert [make_task(config.env).left_edge for config in configs] == [-1.0, -2.0]
    assert configs[0].run_key != configs[1].run_key
