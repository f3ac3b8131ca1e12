"""The paths of episodes: where the car is at the start and after each step."""

import numpy as np
import pytest
from support.user_policies import constant
from support.user_tasks import Steps

from parking_exp.config.compose import compose
from parking_exp.evaluation.evaluate_policy import evaluate_policy
from parking_exp.evaluation.path_recorder import PathRecorder
from parking_exp.tasks.parking.episode_recording import record_episodes
from parking_exp.tasks.registry import make_task

turn = constant(1.0, 0.3)


@pytest.mark.parametrize("simulator", ["vectorized", "highway_env"])
def test_a_path_has_the_pose_at_the_start_and_after_each_step_until_the_crash(simulator):
    env_config = compose("env.duration=10").env
    task = make_task(env_config)
    path_recorder = PathRecorder(task, [7, 2])
    episodes = evaluate_policy(
        turn, task, [1, 2, 3, 7], simulator=simulator, path_recorder=path_recorder
    )
    task.close()

    assert set(episodes["outcome"]) == {"crash"}
    table = path_recorder.table()
    assert list(table) == ["scene", "step", "x_m", "y_m", "heading_rad"]
    assert table["scene"].unique().tolist() == [2, 7]
    for episode in record_episodes(turn, env_config, [2, 7]):
        path = table[table["scene"] == episode.seed]
        x, y, heading = episode.motion[:, :3].T
        assert path["step"].tolist() == list(range(len(x)))
        turned = np.arctan2(np.sin(heading), np.cos(heading))
        poses = path[["x_m", "y_m", "heading_rad"]].to_numpy()
        np.testing.assert_allclose(poses, np.stack([x, y, turned], axis=1), rtol=0, atol=1e-9)


def test_a_task_without_positions_has_no_paths(tmp_path):
    task = Steps()
    path_recorder = PathRecorder(task, [0])
    evaluate_policy(constant(1.0), task, [0], path_recorder=path_recorder)
    path_recorder.write(tmp_path / "paths")
    assert not (tmp_path / "paths").exists()
