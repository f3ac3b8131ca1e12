"""Soft Actor-Critic with a faster update."""

import math
from typing import Any, NamedTuple

import stable_baselines3
import torch
from stable_baselines3.sac.policies import LOG_STD_MAX, LOG_STD_MIN
from torch import nn

from parking_exp.algorithms.fast.critics import Critics
from parking_exp.algorithms.fast.fast_training import FastTraining
from parking_exp.algorithms.fast.minibatches import Minibatch, sample_minibatches
from parking_exp.algorithms.fast.mlp import MLP, parameters
from parking_exp.algorithms.fast.optimizer import Adam, FlatTensors

LOG_SQRT_2_PI = math.log(math.sqrt(2 * math.pi))
EPSILON = 1e-6  # of Stable-Baselines3's SquashedDiagGaussianDistribution


class _Update:
    """The update of a model's networks and entropy coefficient."""

    def __init__(self, model: Any) -> None:
        self.critics = Critics(model)
        body, mean, log_std = parameters(model.actor.latent_pi), model.actor.mu, model.actor.log_std
        assert isinstance(mean, nn.Linear)
        assert isinstance(log_std, nn.Linear)
        self.actor = MLP(body)
        self.mean, self.log_std = (MLP([head.weight, head.bias]) for head in (mean, log_std))
        self.flat = FlatTensors([*body, mean.weight, mean.bias, log_std.weight, log_std.bias])
        self.adam = Adam(model.actor.optimizer, self.flat)
        self.ent_coef_adam: Adam | None = None
        if model.ent_coef_optimizer is not None:
            self.ent_coef_adam = Adam(model.ent_coef_optimizer, FlatTensors([model.log_ent_coef]))

    def run(self, model: Any, gradient_steps: int, batch_size: int) -> dict[str, float]:
        """Do `gradient_steps` updates and return the means of what Stable-Baselines3 logs."""
        history: list[_Logged] = []
        for step, batch in enumerate(sample_minibatches(model, gradient_steps, batch_size)):
            history.append(self._step(model, batch))
            if step % model.target_update_interval == 0:
                self.critics.polyak_update(model.tau)
        model._n_updates += gradient_steps
        return self._losses(model, history)

    def _step(self, model: Any, minibatch: Minibatch) -> "_Logged":
        """Do one update."""
        features, actions, rewards, discounts, _ = (
            minibatch  # only TD3's target noise needs the signs
        )
        n, n_actions = actions.shape
        noise = torch.empty((2, n, n_actions), dtype=features.dtype)
        noise[0].normal_()  # one after the other, as Stable-Baselines3 draws them
        noise[1].normal_()
        # States and next states share the actor: one pass for both.
        values = self.actor.forward(features)
        hidden = values[-1].relu_()
        policy = _SquashedGaussian(
            self.mean.forward(hidden)[-1], self.log_std.forward(hidden)[-1], noise.flatten(0, 1)
        )
        log_prob, next_log_prob = policy.log_prob[:n], policy.log_prob[n:]
        ent_coef = self._update_ent_coef(model, log_prob)

        inputs = torch.cat((features, policy.actions), 1)
        next_value = self.critics.target_value(inputs[n:]) - ent_coef * next_log_prob
        target = rewards + discounts * next_value
        errors = self.critics.update(torch.cat((features[:n], actions), 1), target, weight=0.5)

        value, grad_action = self.critics.action_gradient(inputs[:n], n_actions, first=False)
        grad_mean, grad_log_std = policy.backward(n, grad_action, ent_coef * (1 / n))
        self._update_actor([v[:n] for v in values], grad_mean, grad_log_std)
        return _Logged(ent_coef, log_prob, value, errors)

    def _update_actor(
        self, values: list[torch.Tensor], grad_mean: torch.Tensor, grad_log_std: torch.Tensor
    ) -> None:
        """Pass the gradients by both heads' outputs back through them and the body, and take a
        step.
        """
        *body, _, _, _, _ = gradients = self.adam.gradients
        self.mean.backward(values[-1:], grad_mean, gradients[-4:-2])
        self.log_std.backward(values[-1:], grad_log_std, gradients[-2:])
        grad_hidden = self.mean.input_gradient([], grad_mean) + self.log_std.input_gradient(
            [], grad_log_std
        )
        self.actor.backward(
            values, torch.ops.aten.threshold_backward(grad_hidden, values[-1], 0), body
        )
        self.adam.step()

    def _update_ent_coef(self, model: Any, log_prob: torch.Tensor) -> torch.Tensor:
        """Take a step on the entropy coefficient; return it as it was before, shape (1,)."""
        if self.ent_coef_adam is None:
            return model.ent_coef_tensor.reshape(1)
        ent_coef = model.log_ent_coef.exp()
        surplus = (log_prob + model.target_entropy).mean()
        self.ent_coef_adam.gradients[0].copy_(-surplus)
        self.ent_coef_adam.step()
        return ent_coef

    def _losses(self, model: Any, history: list["_Logged"]) -> dict[str, float]:
        """Return the mean entropy coefficient and losses of several updates: cheaper at once than
        one by one.
        """
        ent_coef, log_prob, value, errors = (
            torch.stack(column) for column in zip(*history, strict=True)
        )
        means = {
            "ent_coef": ent_coef.mean(),
            "actor_loss": (ent_coef.unsqueeze(2) * log_prob - value).mean(),
            "critic_loss": 0.5 * errors.square().mean((0, 2, 3)).sum(),
        }
        if self.ent_coef_adam is not None:
            surplus = log_prob.mean((1, 2)) + model.target_entropy
            means["ent_coef_loss"] = -(ent_coef.squeeze(1).log() * surplus).mean()
        return {name: mean.item() for name, mean in means.items()}


class _Logged(NamedTuple):
    """What the losses of an update are computed from.

    Attributes:
        ent_coef: shape (1,).
        log_prob: of the actor's actions, shape (batch, 1).
        value: the smallest of these actions, shape (batch, 1).
        errors: of the critics, shape (critics, batch, 1).
    """

    ent_coef: torch.Tensor
    log_prob: torch.Tensor
    value: torch.Tensor
    errors: torch.Tensor


class _SquashedGaussian:
    """Actions of a Gaussian policy squashed by tanh, their log probabilities, and the gradients
    through both.

    The operations are those of Stable-Baselines3 and torch.distributions, in their order; terms
    that cancel but for rounding are kept, since Adam's first steps magnify rounding.

    Args:
        mean, raw_log_std: outputs of the actor, shape (n, actions).
        noise: standard normal, of the same shape.

    Attributes:
        actions: shape (n, actions).
        log_prob: shape (n, 1).
    """

    def __init__(self, mean: torch.Tensor, raw_log_std: torch.Tensor, noise: torch.Tensor) -> None:
        self.noise, self.raw_log_std = noise, raw_log_std
        self.std = raw_log_std.clamp(LOG_STD_MIN, LOG_STD_MAX).exp_()
        sample = mean + noise * self.std
        self.actions = torch.tanh(sample)
        self.offset = sample - mean
        self.double_variance = 2 * self.std**2
        density = 1 - self.actions**2 + EPSILON
        log_prob = (-(self.offset**2) / self.double_variance - self.std.log() - LOG_SQRT_2_PI).sum(
            1
        )
        self.log_prob = (log_prob - density.log().sum(1)).unsqueeze(1)

    def backward(
        self, n: int, grad_action: torch.Tensor, grad_log_prob: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the gradients by mean and raw log standard deviation of the first n actions, shape
        (n, actions).

        `grad_action` is the loss's gradient by the actions without log_prob, shape (n, actions);
        `grad_log_prob` that by each log probability, one number.
        """
        noise, std, actions, offset, double_variance, raw_log_std = (
            tensor[:n]
            for tensor in (
                self.noise,
                self.std,
                self.actions,
                self.offset,
                self.double_variance,
                self.raw_log_std,
            )
        )
        density = 1 - actions**2 + EPSILON
        grad_square = -grad_log_prob / double_variance
        grad_offset = grad_square * 2 * offset
        grad_squashed = grad_log_prob / density * (2 * actions) + grad_action
        grad_sample = torch.ops.aten.tanh_backward(grad_squashed, actions) + grad_offset
        grad_double_variance = -grad_log_prob * (-(offset**2) / double_variance / double_variance)
        grad_std = (
            -grad_log_prob / std + (grad_double_variance * 2) * (2 * std) + grad_sample * noise
        )
        inside = (raw_log_std >= LOG_STD_MIN) & (raw_log_std <= LOG_STD_MAX)
        return grad_sample - grad_offset, grad_std * std * inside


class SAC(FastTraining, stable_baselines3.SAC):
    """Stable-Baselines3's SAC with a faster `train`: same arithmetic, constructor, `save`, `load`,
    `predict`, logs.
    """

    update_class = _Update
