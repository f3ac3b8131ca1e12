"""The ego frame, exactly."""

import math

import numpy as np
import pytest
import torch
from support.runs import make_config

from parking_exp.algorithms.features import EgoFrameExtractor
from parking_exp.envs.highway import make_env

SCALES = [100, 100, 5, 5, 1, 1]


def features(car, goal):
    """Features for (x, y, heading, speed) of the car and (x, y, heading) of the goal, in metres and radians."""
    x, y, heading, speed = car
    goal_x, goal_y, goal_heading = goal
    space = make_env(make_config().env).observation_space
    observation = np.array(
        [x, y, speed * math.cos(heading), speed * math.sin(heading), math.cos(heading), math.sin(heading)]
    )
    desired = np.array([goal_x, goal_y, 0, 0, math.cos(goal_heading), math.sin(goal_heading)])
    batch = {
        "observation": observation / SCALES,
        "achieved_goal": observation / SCALES,
        "desired_goal": desired / SCALES,
    }
    tensors = {key: torch.tensor(value, dtype=torch.float32)[None] for key, value in batch.items()}
    return EgoFrameExtractor(space, SCALES)(tensors)[0].tolist()


def test_a_goal_ahead_and_to_the_left():
    # The car looks along +y; 20 m ahead of it and 10 m to its left the slot looks along -x.
    found = features(car=(0, 0, math.pi / 2, 2.5), goal=(-10, 20, math.pi))
    expected = [2.0, 1.0, 0.0, 1.0, 0.5, math.sqrt(5), 0.0, 0.0, 0.0, 1.0]
    assert found == pytest.approx(expected, abs=1e-6)


def test_driving_backwards_has_a_negative_speed():
    assert features(car=(0, 0, 0.3, -5), goal=(10, 0, 0))[4] == pytest.approx(-1.0, abs=1e-6)


def test_the_pose_in_the_lot_is_scaled_by_the_walls():
    assert features(car=(35, -21, 0, 0), goal=(0, 0, 0))[6:] == pytest.approx([1.0, -1.0, 1.0, 0.0], abs=1e-6)


def test_goal_features_do_not_depend_on_where_the_scene_lies():
    here = features(car=(0, 0, 0.4, 1), goal=(7, 3, 1.0))
    turn, shift = 0.9, np.array([4.0, -2.0])
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    goal = rotation @ [7, 3] + shift
    there = features(car=(*shift, 0.4 + turn, 1), goal=(*goal, 1.0 + turn))
    assert there[:6] == pytest.approx(here[:6], abs=1e-5)
