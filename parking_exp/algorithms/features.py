"""Features that the policy computes from the goal observation."""

from collections.abc import Sequence

import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from parking_exp.envs.geometry import LOT_LENGTH_M, LOT_WIDTH_M

GOAL_SCALE_M = 10.0


class EgoFrameExtractor(BaseFeaturesExtractor):
    """Goal, speed and pose as the car sees them, from parking-v0's Dict observation.

    In the raw observation a slot's tolerance is about 1 % of the input's range; in the car's own frame, and in
    units of 10 m, the policy can see it. The features are computed inside the policy, from `observation` and
    `desired_goal`, so goals that HER relabels pass through them like any other.

    Output, shape (batch, 10): goal ahead and to the side (10 m), cos and sin of the goal's heading relative to the
    car's, signed speed (observation units), distance to the goal (10 m), x and y in the lot (half its length and
    width), cos and sin of the heading.

    Args:
        observation_space: parking-v0's, with the features x, y, vx, vy, cos_h, sin_h.
        scales: metres (or m/s) that stand for 1 in each of them: `env.observation.scales`.
    """

    def __init__(self, observation_space: spaces.Dict, scales: Sequence[float]) -> None:
        super().__init__(observation_space, features_dim=10)
        self.x_scale, self.y_scale = float(scales[0]), float(scales[1])

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return features of shape (batch, 10) for observations of shape (batch, 6) each."""
        x, y, vx, vy, cos_h, sin_h = observations["observation"].unbind(-1)
        goal_x, goal_y, _, _, goal_cos, goal_sin = observations["desired_goal"].unbind(-1)
        dx, dy = (goal_x - x) * self.x_scale, (goal_y - y) * self.y_scale
        return torch.stack(
            (
                (cos_h * dx + sin_h * dy) / GOAL_SCALE_M,
                (cos_h * dy - sin_h * dx) / GOAL_SCALE_M,
                goal_cos * cos_h + goal_sin * sin_h,
                goal_sin * cos_h - goal_cos * sin_h,
                vx * cos_h + vy * sin_h,
                torch.sqrt(dx * dx + dy * dy) / GOAL_SCALE_M,
                x * (2 * self.x_scale / LOT_LENGTH_M),
                y * (2 * self.y_scale / LOT_WIDTH_M),
                cos_h,
                sin_h,
            ),
            dim=-1,
        )
