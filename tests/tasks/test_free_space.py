"""Poses at which a car touches something are those where its rectangle does."""

import numpy as np
import pytest
from shapely import box
from support.shapes import polygon

from parking_exp.config.compose import compose
from parking_exp.tasks.parking.free_space import FreeSpace
from parking_exp.tasks.parking.geometry import (
    CAR_LENGTH_M,
    CAR_WIDTH_M,
    OBSTACLE_M,
    REAR_AXLE_M,
    move_ahead,
)
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.scenes import NO_SLOT

LOTS = (
    ["env=parking_parallel", "env.level=hard"],
    ["env=parking_bays", "env.level=normal"],
    ["env=parking_lots", "env.level=normal"],
    ["env=parking_crowded", "env.obstacles=3"],
)


def touches(scenes, pose, **arguments):
    """Return whether a car touches something when its middle is at a pose."""
    rear = move_ahead(pose[None], -REAR_AXLE_M)
    return not FreeSpace(scenes, **arguments).contains(rear)


def shapes_of(scenes):
    """What stands in a scene, and the space between its walls."""
    parked = [
        polygon(*pose, CAR_LENGTH_M, CAR_WIDTH_M)
        for pose, slot in zip(scenes.vehicle_pose[0], scenes.vehicles[0], strict=True)
        if slot != NO_SLOT
    ]
    obstacles = [polygon(*place, 0.0, OBSTACLE_M, OBSTACLE_M) for place in scenes.obstacles[0]]
    half_x, half_y = scenes.free[:, 0]
    return parked + obstacles, box(-half_x, -half_y, half_x, half_y)


@pytest.mark.parametrize("overrides", LOTS)
def test_contacts_are_those_of_the_shapes(overrides):
    lot = lot_of(compose(*overrides).env)
    rng = np.random.default_rng(0)
    touching = []
    for seed in range(20):
        scenes = lot.from_seeds([seed])
        others, inside = shapes_of(scenes)
        for pose in scenes.goal_pose + rng.normal(0, [3, 3, 1], (50, 3)):
            car = polygon(*pose, CAR_LENGTH_M, CAR_WIDTH_M)
            hit = any(car.intersects(other) for other in others) or not inside.contains(car)
            assert touches(scenes, pose, walls=True) == hit
            touching.append(hit)
    assert 0.2 < np.mean(touching) < 0.9


def test_a_path_is_free_if_a_car_fits_at_all_of_its_poses():
    scenes = lot_of(compose("env=parking").env).from_seeds([0])
    space = FreeSpace(scenes, walls=True)
    free = np.array([0.0, 0.0, 0.0])
    in_the_wall = np.array([40.0, 0.0, 0.0])
    assert space.contains(np.array([free, free]))
    assert not space.contains(np.array([free, in_the_wall]))


def test_a_margin_is_kept_on_all_sides():
    env = compose("env=parking_parallel", "env.lot.slot_length_m=7").env
    scenes = lot_of(env).from_seeds([0])
    (at_goal,) = scenes.goal_pose  # 2 m from the cars before and behind, 1 m from the wall
    assert not touches(scenes, at_goal, walls=False, margin_m=1.99)
    assert touches(scenes, at_goal, walls=False, margin_m=2.01)
    assert not touches(scenes, at_goal, walls=True, margin_m=0.99)
    assert touches(scenes, at_goal, walls=True, margin_m=1.01)
