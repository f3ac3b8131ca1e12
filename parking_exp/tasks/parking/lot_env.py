"""Parametric lots as environments of highway-env, which simulates them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from highway_env.envs.parking_env import ParkingEnv
from highway_env.road.lane import LineType, StraightLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.graphics import VehicleGraphics
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Landmark, Obstacle

from parking_exp.tasks.parking.geometry import walls_around
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.parking_config import ParkingConfig
from parking_exp.tasks.parking.reward import reward_of
from parking_exp.tasks.parking.scenes import NO_SLOT, Scenes

LINES = (LineType.CONTINUOUS, LineType.CONTINUOUS)


class LotEnv(ParkingEnv):
    """highway-env's parking env on a parametric lot.

    `info` has the size of the goal slot, by which `compute_reward` decides whether a car is parked.
    """

    def __init__(self, config: ParkingConfig, render_mode: str | None = None) -> None:
        self.lot: Any = lot_of(config)  # not highway-env's own
        self.goal_reward = reward_of(config)
        super().__init__(config.highway_options(), render_mode)

    @property
    def slot_size(self) -> np.ndarray:
        """Length and width of the goal slot, shape (2,) [m]."""
        return self.scene.slot_size[0]

    def _create_road(self, spots: int = 0) -> None:
        """Sample a scene, and make a lane for each of its slots."""
        self.scene: Scenes = self.lot.scenes(self.np_random.random((1, self.lot.n_draws)))
        length, width = self.slot_size
        network = RoadNetwork()
        for x, y, heading in self.scene.slots[0]:
            half = np.array([np.cos(heading), np.sin(heading)]) * length / 2
            centre = np.array([x, y])
            lane = StraightLane(centre - half, centre + half, width=width, line_types=LINES)
            network.add_lane("a", "b", lane)
        self.road = Road(
            network=network,
            np_random=self.np_random,
            record_history=self.config["show_trajectories"],
        )

    def _create_vehicles(self) -> None:
        """Put the car, its goal, the parked cars and the walls on the lot."""
        scene = self.scene
        road = self.road
        car = self.action_type.vehicle_class(road, scene.start[0, :2], scene.start[0, 2], 0.0)
        car.color = VehicleGraphics.EGO_COLOR
        x, y, heading = scene.goal_pose[0]
        car.goal = Landmark(road, [x, y], heading=heading)
        self.controlled_vehicles = [car]
        road.vehicles.append(car)
        road.objects.append(car.goal)

        for slot, (x, y, heading) in zip(scene.vehicles[0], scene.vehicle_pose[0], strict=True):
            if slot != NO_SLOT:
                road.vehicles.append(Vehicle(road, [x, y], heading, 0.0))
        if self.config["add_walls"]:
            self._create_walls()

    def _create_walls(self) -> None:
        walls = walls_around(self.scene.free)
        for number, (length, width) in enumerate(walls.size[0]):
            wall = Obstacle(self.road, walls.centre[0, number], walls.heading[0, number])
            wall.LENGTH = length
            wall.WIDTH = width
            wall.diagonal = walls.diagonal[0, number]
            self.road.objects.append(wall)

    def compute_reward(
        self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any, p: float = 0.5
    ) -> Any:
        """Return the reward of goals, shape (6,) or (batch, 6), without a penalty for crashes.

        Args:
            achieved_goal, desired_goal: goals as the observation has them.
            info: the step's `info`, or a list of one for each goal. Without the size of the slot,
                one dict stands for the present scene.
            p: unused.

        Raises:
            ValueError: an entry of a list has no size of the slot.
        """
        slot_size = self.slot_size
        if not isinstance(info, dict):
            slot_size = self._slot_sizes(info)
        elif info.keys() >= set(self.goal_reward.info_keys):
            slot_size = np.array([info[key] for key in self.goal_reward.info_keys])
        return self.goal_reward(achieved_goal, desired_goal, slot_size)[0]

    def _slot_sizes(self, infos: Sequence[dict[str, Any]]) -> np.ndarray:
        """Return the sizes of slots that infos have, shape (n, 2) [m]."""
        try:
            sizes = [[info[key] for key in self.goal_reward.info_keys] for info in infos]
        except KeyError as error:
            raise ValueError(
                f"info has no {error}: HerReplayBuffer needs copy_info_dict=True on this env"
            ) from error
        return np.array(sizes)

    def _is_success(self, achieved_goal: np.ndarray, desired_goal: np.ndarray) -> bool:
        return bool(self.goal_reward(achieved_goal, desired_goal, self.slot_size)[1])

    def _info(self, obs: Any, action: Any) -> dict[str, Any]:
        sizes = zip(self.goal_reward.info_keys, self.slot_size.tolist(), strict=True)
        return super()._info(obs, action) | dict(sizes)
