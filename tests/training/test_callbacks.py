"""Stable-Baselines3 callbacks of a user's own package, named in the config."""

import pytest
from support.runs import config_refusal
from support.user_callbacks import KeepsArguments

from parking_exp.config.compose import compose
from parking_exp.sweeps.single_run import train

COUNTS = "support.user_callbacks.CountsRollouts"


def config(tmp_path, callbacks):
    return compose("experiment=smoke", f"output_dir={tmp_path}", f"callbacks=[{callbacks}]")


def test_a_callback_logs_metrics_of_the_run_and_may_end_its_training(tmp_path):
    result = train(config(tmp_path, f"{{_target_:{COUNTS},stop_at:300}}"))

    assert result.steps == 300
    # Two envs take two steps in a rollout, and the last one has no end.
    assert result.metrics["mine/rollouts"] == 149


def test_a_callback_gets_plain_lists_and_dicts(tmp_path):
    target = "support.user_callbacks.KeepsArguments"
    train(config(tmp_path, f"{{_target_:{target},names:[a,b],limits:{{low:0.5}}}}"))

    assert KeepsArguments.received == [list, dict]


def test_a_callback_changes_the_key_of_a_run(tmp_path):
    plain = compose("experiment=smoke", f"output_dir={tmp_path}")

    assert config(tmp_path, COUNTS).run_key != plain.run_key
    assert config(tmp_path, COUNTS).run_key == config(tmp_path, f"{{_target_:{COUNTS}}}").run_key


@pytest.mark.parametrize(
    ("callbacks", "problem"),
    [
        ("a.B", "callbacks.0._target_=a.B: ModuleNotFoundError: No module named 'a'"),
        (
            "parking_exp.algorithms.SAC",
            "callbacks.0._target_=parking_exp.algorithms.SAC is not a subclass of "
            "stable_baselines3.common.callbacks.BaseCallback",
        ),
        (
            f"{{_target_:{COUNTS},stop_att:1}}",
            "callbacks.0.stop_att: there is no such key; did you mean 'stop_at'?",
        ),
    ],
)
def test_what_is_no_callback_is_refused(callbacks, problem):
    assert config_refusal(f"callbacks=[{callbacks}]") == problem
