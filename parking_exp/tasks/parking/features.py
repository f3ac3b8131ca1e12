"""Features that the policy computes from the goal observation."""

from collections.abc import Sequence
from typing import Any

import torch
from gymnasium import spaces

from parking_exp.tasks.feature_extractors import SymmetricFeatures, TaskFeatures
from parking_exp.tasks.parking.geometry import LOT_LENGTH_M, LOT_WIDTH_M
from parking_exp.tasks.parking.nearby_vehicles import ENTRIES
from parking_exp.tasks.parking.parking_config import DEFAULT_FEATURES, DEFAULT_SCALES

# Units of distances in features: to the goal, at the scale of a slot, and to vehicles.
GOAL_SCALE_M = 10.0
NEAR_M = 2.0
VEHICLE_M = 4.0
X_SCALE, Y_SCALE = map(float, DEFAULT_SCALES[:2])  # metres per unit of the observation


class EgoFrameExtractor(TaskFeatures):
    """Goal, speed and pose as the car sees them, from parking-v0's Dict observation.

    In the raw observation, a slot's tolerance is about 1 % of the input's range. The car's own
    frame and units of 10 m make it visible to the policy. The policy computes the features from
    `observation` and `desired_goal`, so they also apply to goals that HER relabels.

    Other vehicles and rays that the observation shows come last, in the car's frame, too.

    Output, shape (batch, 10 + 5 K + N) for K other vehicles and N rays. Column:

        0, 1    goal ahead and to the left (10 m)
        2, 3    cos and sin of the goal's heading relative to the car's
        4       signed speed (observation units)
        5       distance to the goal (10 m)
        6, 7    x and y in the lot (half its length and width)
        8, 9    cos and sin of the heading

    5 columns of each vehicle follow: presence, ahead and to the left (10 m), cos and sin of its
    heading relative to the car's. They are 0 where there is no vehicle. Then comes a column for
    each ray, 1 minus the observed fraction. It is 0 where nothing is seen.

    Args:
        observation_space: the env's observation space.
        features_dim: number of features of car and goal.
        lot_size_m: length and width of the lot, the scales of x and y.
        rays: number of rays in the observation.
    """

    features_per_vehicle = 5

    def __init__(
        self,
        observation_space: spaces.Dict,
        features_dim: int = 10,
        lot_size_m: Sequence[float] = (LOT_LENGTH_M, LOT_WIDTH_M),
        rays: int = 0,
    ) -> None:
        size = spaces.flatdim(observation_space["observation"])
        self.first_ray_entry = size - rays
        self.vehicles_count = (self.first_ray_entry - len(DEFAULT_FEATURES)) // len(ENTRIES)
        n_vehicle_features = self.vehicles_count * self.features_per_vehicle
        super().__init__(observation_space, features_dim + n_vehicle_features + rays)
        self.lot_size_m = lot_size_m
        self.rays = rays

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return features of shape (batch, features) for observations of shape (batch, 6 + 5 K + N)
        and goals of 6.
        """
        car_features = self.encode_car(observations)
        parts = [car_features]
        if self.vehicles_count:
            parts.append(self.encode_vehicles(observations, car_features).flatten(1))
        if self.rays:
            parts.append(1 - observations["observation"][:, self.first_ray_entry :])
        return torch.cat(parts, dim=-1)

    def encode_vehicles(
        self, observations: dict[str, torch.Tensor], car_features: torch.Tensor
    ) -> torch.Tensor:
        """Return the vehicles' features, (batch, K, features of each), 0 where there is none."""
        observation = observations["observation"]
        entries = observation[:, len(DEFAULT_FEATURES) : self.first_ray_entry]
        seen = entries.unflatten(-1, (self.vehicles_count, len(ENTRIES)))
        cos_h = observation[:, 4:5]
        sin_h = observation[:, 5:6]
        presence, x, y, cos, sin = seen.unbind(-1)
        dx = x * (X_SCALE / GOAL_SCALE_M)
        dy = y * (Y_SCALE / GOAL_SCALE_M)
        return torch.stack(
            (
                presence,
                cos_h * dx + sin_h * dy,
                cos_h * dy - sin_h * dx,
                cos * cos_h + sin * sin_h,
                sin * cos_h - cos * sin_h,
            ),
            dim=-1,
        )

    def encode_car(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return the features of car and goal, shape (batch, 10)."""
        car = observations["observation"][:, : len(DEFAULT_FEATURES)]
        x, y, vx, vy, cos_h, sin_h = car.unbind(-1)
        goal_x, goal_y, _, _, goal_cos, goal_sin = observations["desired_goal"].unbind(-1)
        dx = (goal_x - x) * X_SCALE
        dy = (goal_y - y) * Y_SCALE
        length, width = self.lot_size_m
        return torch.stack(
            (
                (cos_h * dx + sin_h * dy) / GOAL_SCALE_M,
                (cos_h * dy - sin_h * dx) / GOAL_SCALE_M,
                goal_cos * cos_h + goal_sin * sin_h,
                goal_sin * cos_h - goal_cos * sin_h,
                vx * cos_h + vy * sin_h,
                torch.sqrt(dx * dx + dy * dy) / GOAL_SCALE_M,
                x * (2 * X_SCALE / length),
                y * (2 * Y_SCALE / width),
                cos_h,
                sin_h,
            ),
            dim=-1,
        )


class FineEgoFrameExtractor(EgoFrameExtractor):
    """Ego-frame features, and the car in the goal's frame. Both also come at the scale of a slot.

    Most lots are symmetric under a turn by 180 degrees, so pose and heading are turned where the
    goal's y is negative, which halves the state space and changes no action. Positions and reward
    also come at the scale of a slot, since the reward has a cusp at the goal. The goal's frame
    shows whether the car is in line with the slot, and which of the neighbouring slots are taken.

    Output, shape (batch, 19 + 9 K + N), one more if `reward_weights` weigh velocity. Column:

        0 to 5  as in `EgoFrameExtractor`
        6 to 9  x, y, cos and sin of the heading, as there, turned to the goal
        10, 11  the car along and across the goal's heading, seen from the goal (10 m)
        12, 13  the car's velocity in these directions (observation units)
        14, 15  tanh(goal ahead / 2 m), tanh(goal to the left / 2 m)
        16, 17  tanh(car along / 2 m), tanh(car across / 2 m)
        18      weighted distance, the dense reward of parking-v0 times -1
        19      signed speed of the goal (observation units), if `reward_weights` weigh velocity

    9 columns of each vehicle follow: the 5 of `EgoFrameExtractor`, tanh(ahead / 4 m), tanh(left /
    4 m), and the same for along and across the goal's heading, seen from the goal. Rays come last.

    Args:
        observation_space: the env's observation space.
        reward_weights: the env's weights of the reward.
        features_dim: number of features of car and goal, without the speed of a goal.
        turned: whether the lot equals itself when it is turned by 180 degrees.
        lot: `lot_size_m` and `rays` of `EgoFrameExtractor`.
    """

    features_per_vehicle = 9

    def __init__(
        self,
        observation_space: spaces.Dict,
        reward_weights: Sequence[float],
        features_dim: int = 19,
        turned: bool = True,
        **lot: Any,
    ) -> None:
        weights = [float(weight) for weight in reward_weights]
        # Virtual goals may move, real ones never do: networks see the difference only if the reward
        # depends on it.
        moving_goals = any(weights[2:4])
        super().__init__(observation_space, features_dim + moving_goals, **lot)
        self.reward_weights = weights
        self.turned = turned
        self.moving_goals = moving_goals

    def encode_vehicles(
        self, observations: dict[str, torch.Tensor], car_features: torch.Tensor
    ) -> torch.Tensor:
        """Return the vehicles' features, (batch, K, 9), 0 where there is none."""
        vehicles = super().encode_vehicles(observations, car_features)
        presence, ahead, left = vehicles[..., :3].unbind(-1)
        goal_ahead, goal_left, cos, sin = car_features[:, :4].split(1, dim=-1)
        dx = ahead - goal_ahead
        dy = left - goal_left
        near = torch.stack((ahead, left, cos * dx + sin * dy, cos * dy - sin * dx), dim=-1)
        near = torch.tanh(near * (GOAL_SCALE_M / VEHICLE_M)) * presence[..., None]
        return torch.cat((vehicles, near), dim=-1)

    def encode_car(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return the features of car and goal, shape (batch, 19 or 20)."""
        features = super().encode_car(observations)
        car = observations["observation"][:, : len(DEFAULT_FEATURES)]
        goal = observations["desired_goal"]
        pose = features[:, 6:]
        if self.turned:
            pose = pose * torch.where(goal[:, 1:2] < 0, -1.0, 1.0).to(features)
        ahead, left, cos, sin, speed = features[:, :5].split(1, dim=-1)
        from_goal = torch.cat((-cos * ahead - sin * left, sin * ahead - cos * left), dim=-1)
        near = torch.cat((features[:, :2], from_goal), dim=-1) * (GOAL_SCALE_M / NEAR_M)
        weights = features.new_tensor(self.reward_weights)[:, None]
        parts = [
            features[:, :6],
            pose,
            from_goal,
            speed * cos,
            -speed * sin,
            torch.tanh(near),
            torch.sqrt((car - goal).abs() @ weights),
        ]
        if self.moving_goals:
            parts.append((goal[:, 2:4] * goal[:, 4:6]).sum(-1, keepdim=True))
        return torch.cat(parts, dim=-1)


class MirroredEgoFrameExtractor(FineEgoFrameExtractor, SymmetricFeatures):
    """Fine ego-frame features, mirrored so that the goal is never to the right of the car.

    Mirroring most lots, x to -x, only changes the sign of the steering. So networks learn one of
    two mirror images, and the policies in `mirrored_policies` reverse the steering where a scene
    is mirrored. In a `handed` lot, networks also see which of the two images it is.

    Output: as `FineEgoFrameExtractor`'s. If the goal is to the right, all lateral features have the
    other sign, and rays the opposite order. In a handed lot, a last feature is 1, or -1 if the
    goal is to the right.

    Args:
        observation_space: the env's observation space.
        reward_weights: the env's weights of the reward.
        handed: whether the lot is not its own mirror image.
        lot: further arguments of `FineEgoFrameExtractor`.
    """

    ACROSS = (1, 3, 6, 8, 11, 13, 15, 17)  # features that a mirror turns around
    ACROSS_OF_VEHICLE = (2, 4, 6, 8)  # the same, for each vehicle

    mirror_signs: torch.Tensor
    mirror_order: torch.Tensor

    def __init__(
        self,
        observation_space: spaces.Dict,
        reward_weights: Sequence[float],
        handed: bool = False,
        **lot: Any,
    ) -> None:
        super().__init__(observation_space, reward_weights, 19 + handed, **lot)
        self.handed = handed
        across = list(self.ACROSS)
        size = self.features_dim - handed
        first_ray = size - self.rays
        first_vehicle = first_ray - self.vehicles_count * self.features_per_vehicle
        for first in range(first_vehicle, first_ray, self.features_per_vehicle):
            across += [first + lateral for lateral in self.ACROSS_OF_VEHICLE]
        signs = torch.ones(size)
        signs[across] = -1.0
        self.register_buffer("mirror_signs", signs, persistent=False)
        order = torch.arange(size)
        # The first ray looks ahead, also in the mirror. The second one becomes the last one.
        order[first_ray + 1 :] = order[first_ray + 1 :].flip(0)
        self.register_buffer("mirror_order", order, persistent=False)

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return features of shape (batch, features) for observations of shape (batch, 6 + 5 K + N)
        and goals of 6.
        """
        features = super().forward(observations)
        mirrored = features * self.mirror_signs
        if self.rays:
            mirrored = mirrored[:, self.mirror_order]
        sign = self.sign(observations)
        seen = torch.where(sign < 0, mirrored, features)
        if self.handed:
            return torch.cat((seen, sign.to(seen)), dim=-1)
        return seen

    def sign(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return -1 where the scene is mirrored, else 1; shape (batch, 1)."""
        # In single precision as in the networks, whatever the buffer holds: one sign for features
        # and actions.
        observation = observations["observation"].float()
        goal = observations["desired_goal"].float()
        scales = goal.new_tensor([X_SCALE, Y_SCALE])
        x, y = ((goal[:, :2] - observation[:, :2]) * scales).split(1, dim=1)
        left = y * observation[:, 4:5] - x * observation[:, 5:6]
        return torch.where(left < 0, -1.0, 1.0)

    def mirror(self, actions: torch.Tensor, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return actions, (batch, actions), with the steering reversed if a scene is mirrored."""
        return torch.cat((actions[:, :-1], actions[:, -1:] * self.sign(observations)), dim=1)


EXTRACTORS: dict[str, type[EgoFrameExtractor]] = {
    "ego": EgoFrameExtractor,
    "ego_fine": FineEgoFrameExtractor,
    "ego_mirrored": MirroredEgoFrameExtractor,
}
"""By their names in the config."""
