"""Features that the policy computes from the goal observation."""

from collections.abc import Sequence

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

    In the raw observation a slot's tolerance is about 1 % of the input's range; in the car's own
    frame, and in units of 10 m, the policy can see it. The features are computed inside the policy,
    from `observation` and `desired_goal`, so goals that HER relabels pass through them like any
    other.

    Other vehicles that the observation shows come last, each in the car's frame, too.

    Output, shape (batch, 10 + 5 K) for K other vehicles: goal ahead and to the side (10 m), cos and
    sin of the goal's heading relative to the car's, signed speed (observation units), distance to
    the goal (10 m), x and y in the lot (half its length and width), cos and sin of the heading; of
    each vehicle presence, ahead and to the side (10 m), cos and sin of its heading relative to the
    car's.
    """

    of_each_vehicle = 5  # features

    def __init__(self, observation_space: spaces.Dict, features_dim: int = 10) -> None:
        size = spaces.flatdim(observation_space["observation"]) - len(DEFAULT_FEATURES)
        self.vehicles_count = size // len(ENTRIES)
        super().__init__(
            observation_space, features_dim + self.vehicles_count * self.of_each_vehicle
        )

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return features of shape (batch, features) for observations of shape (batch, 6 + 5 K) and
        goals of 6.
        """
        features = self.of_car(observations)
        if not self.vehicles_count:
            return features
        return torch.cat((features, self.of_vehicles(observations, features).flatten(1)), dim=-1)

    def of_vehicles(
        self, observations: dict[str, torch.Tensor], of_car: torch.Tensor
    ) -> torch.Tensor:
        """Return the features of the vehicles, shape (batch, K, features of each); they are 0 where
        there is none.
        """
        observation = observations["observation"]
        seen = observation[:, len(DEFAULT_FEATURES) :].unflatten(
            -1, (self.vehicles_count, len(ENTRIES))
        )
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

    def of_car(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return the features of car and goal, shape (batch, 10)."""
        car = observations["observation"][:, : len(DEFAULT_FEATURES)]
        x, y, vx, vy, cos_h, sin_h = car.unbind(-1)
        goal_x, goal_y, _, _, goal_cos, goal_sin = observations["desired_goal"].unbind(-1)
        dx = (goal_x - x) * X_SCALE
        dy = (goal_y - y) * Y_SCALE
        return torch.stack(
            (
                (cos_h * dx + sin_h * dy) / GOAL_SCALE_M,
                (cos_h * dy - sin_h * dx) / GOAL_SCALE_M,
                goal_cos * cos_h + goal_sin * sin_h,
                goal_sin * cos_h - goal_cos * sin_h,
                vx * cos_h + vy * sin_h,
                torch.sqrt(dx * dx + dy * dy) / GOAL_SCALE_M,
                x * (2 * X_SCALE / LOT_LENGTH_M),
                y * (2 * Y_SCALE / LOT_WIDTH_M),
                cos_h,
                sin_h,
            ),
            dim=-1,
        )


class FineEgoFrameExtractor(EgoFrameExtractor):
    """Ego-frame features, the car in the goal's frame, both also at the scale of a slot, in a lot
    turned to the goal.

    The lot is symmetric under a turn by 180 degrees, so pose and heading are turned where the
    goal's y is negative, which halves the state space and changes no action. Positions and reward
    also come at the scale of a slot, since the reward has a cusp at the goal. The goal's frame
    shows whether the car is in line with the slot, and which of the neighbouring slots are taken.

    Output, shape (batch, 19 + 9 K), or (batch, 20 + 9 K) if `reward_weights` weigh velocity: the
    features of `EgoFrameExtractor` but for the vehicles; the car's position along and across the
    goal's heading, seen from the goal (10 m), and its velocity in these directions (observation
    units); the goal ahead and to the side, and the car along and across, as tanh of their distance
    / 2 m; the root of the weighted distance, which is minus the dense reward; the goal's signed
    speed (observation units); of each vehicle those of `EgoFrameExtractor`, ahead and to the side
    as tanh of the distance / 4 m, and along and across the goal's heading, seen from the goal, as
    tanh of the distance / 4 m.
    """

    of_each_vehicle = 9

    def __init__(self, observation_space: spaces.Dict, reward_weights: Sequence[float]) -> None:
        weights = [float(weight) for weight in reward_weights]
        # Virtual goals may move, real ones never do: networks see the difference only if the reward
        # depends on it.
        moving_goals = any(weights[2:4])
        super().__init__(observation_space, 19 + moving_goals)
        self.reward_weights = weights
        self.moving_goals = moving_goals

    def of_vehicles(
        self, observations: dict[str, torch.Tensor], of_car: torch.Tensor
    ) -> torch.Tensor:
        """Return the features of the vehicles, shape (batch, K, 9); they are 0 where there is
        none.
        """
        vehicles = super().of_vehicles(observations, of_car)
        presence, ahead, left = vehicles[..., :3].unbind(-1)
        goal_ahead, goal_left, cos, sin = of_car[:, :4].split(1, dim=-1)
        dx = ahead - goal_ahead
        dy = left - goal_left
        near = torch.stack((ahead, left, cos * dx + sin * dy, cos * dy - sin * dx), dim=-1)
        near = torch.tanh(near * (GOAL_SCALE_M / VEHICLE_M)) * presence[..., None]
        return torch.cat((vehicles, near), dim=-1)

    def of_car(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return the features of car and goal, shape (batch, 19 or 20)."""
        features = super().of_car(observations)
        car = observations["observation"][:, : len(DEFAULT_FEATURES)]
        goal = observations["desired_goal"]
        side = torch.where(goal[:, 1:2] < 0, -1.0, 1.0).to(features)
        ahead, left, cos, sin, speed = features[:, :5].split(1, dim=-1)
        from_goal = torch.cat((-cos * ahead - sin * left, sin * ahead - cos * left), dim=-1)
        near = torch.cat((features[:, :2], from_goal), dim=-1) * (GOAL_SCALE_M / NEAR_M)
        weights = features.new_tensor(self.reward_weights)[:, None]
        parts = [
            features[:, :6],
            features[:, 6:] * side,
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

    A mirrored lot is the same but for the sign of the steering. Networks then learn one of two
    mirror images; the policies in `mirrored_policies` turn the steering around with them.

    Output: that of `FineEgoFrameExtractor`; if the goal is to the right, all lateral features have
    the other sign.
    """

    ACROSS = (1, 3, 6, 8, 11, 13, 15, 17)  # features that a mirror turns around
    ACROSS_OF_VEHICLE = (2, 4, 6, 8)  # of each vehicle

    mirror_signs: torch.Tensor

    def __init__(self, observation_space: spaces.Dict, reward_weights: Sequence[float]) -> None:
        super().__init__(observation_space, reward_weights)
        across = list(self.ACROSS)
        n_of_vehicles = self.vehicles_count * self.of_each_vehicle
        first_vehicle = self.features_dim - n_of_vehicles
        for first in range(first_vehicle, self.features_dim, self.of_each_vehicle):
            across += [first + lateral for lateral in self.ACROSS_OF_VEHICLE]
        signs = torch.ones(self.features_dim)
        signs[across] = -1.0
        self.register_buffer("mirror_signs", signs, persistent=False)

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return features of shape (batch, features) for observations of shape (batch, 6 + 5 K) and
        goals of 6.
        """
        features = super().forward(observations)
        return torch.where(self.sign(observations) < 0, features * self.mirror_signs, features)

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
        """Return actions, shape (batch, actions), with the steering turned around where the scene
        is mirrored.
        """
        return torch.cat((actions[:, :-1], actions[:, -1:] * self.sign(observations)), dim=1)
