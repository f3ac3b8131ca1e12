"""The paths of episodes: where the car is at the start and after each step."""

import numpy as np
import pandas as pd
import pytest
from support.user_policies import constant
from support.user_tasks import Steps

from parking_exp.config.compose import compose
from parking_exp.evaluation.evaluate_policy import evaluate_policy
from parking_exp.evaluation.path_recorder import PathRecorder
from parking_exp.tasks.parking.highway import make_parking_env
from parking_exp.tasks.registry import make_task

turn = constant(1.0, 0.3)


def driven(env_config, seed):
    """The poses of a car that turns until its episode ends, as highway-env has them."""
    env = make_parking_env(env_config)
    env.reset(seed=seed)
    car = env.unwrapped.vehicle
    poses = [[*car.position, car.heading]]
    done = False
    while not done:
        _, _, terminated, truncated, _ = env.step(np.array([1.0, 0.3]))
        poses.append([*car.position, car.heading])
        done = terminated or truncated
    poses = np.array(poses)
    poses[:, 2] = np.arctan2(np.sin(poses[:, 2]), np.cos(poses[:, 2]))
    return poses


@pytest.mark.parametrize("simulator", ["vectorized", "highway_env"])
def test_a_path_has_the_pose_at_the_start_and_after_each_step_until_the_crash(simulator):
    env_config = compose("env.duration=10").env
    task = make_task(env_config)
    paths = PathRecorder(task, [7, 2])
    episodes = evaluate_policy(turn, task, [1, 2, 3, 7], simulator=simulator, paths=paths)
    task.close()

    assert set(episodes["outcome"]) == {"crash"}
    table = paths.table()
    assert list(table) == ["scene", "step", "x_m", "y_m", "heading_rad"]
    assert table["scene"].unique().tolist() == [2, 7]
    for seed, path in table.groupby("scene"):
        expected = driven(env_config, seed)
        assert path["step"].tolist() == list(range(len(expected)))
        poses = path[["x_m", "y_m", "heading_rad"]].to_numpy()
        np.testing.assert_allclose(poses, expected, rtol=0, atol=1e-9)


def test_equal_paths_are_equal_files_in_millimetres(tmp_path):
    task = make_task(compose("env.duration=1").env)
    for name in ("first", "second"):
        paths = PathRecorder(task, [0])
        evaluate_policy(turn, task, [0], paths=paths)
        paths.write(tmp_path / name)
    assert (tmp_path / "first").read_bytes() == (tmp_path / "second").read_bytes()
    stored = pd.read_csv(tmp_path / "first", compression="gzip")
    pd.testing.assert_frame_equal(stored, paths.table().round(3))


def test_a_task_without_positions_has_no_paths(tmp_path):
    task = Steps()
    paths = PathRecorder(task, [0])
    evaluate_policy(constant(1.0), task, [0], paths=paths)
    paths.write(tmp_path / "paths")
    assert not (tmp_path / "paths").exists()
