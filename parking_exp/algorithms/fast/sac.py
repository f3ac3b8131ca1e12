"""Soft Actor-Critic with a faster update."""

import math
from typing import Any, NamedTuple

import stable_baselines3
import torch
from stable_baselines3.sac.policies import LOG_STD_MAX, LOG_STD_MIN

from parking_exp.algorithms.fast.critics import Critics
from parking_exp.algorithms.fast.fast_training import FastTraining
from parking_exp.algorithms.fast.minibatches import Minibatch, sample_minibatches
from parking_exp.algorithms.fast.mlp import MLP, tensors_of
from parking_exp.algorithms.fast.optimizer import Adam, FlatTensors

LOG_SQRT_2_PI = math.log(math.sqrt(2 * math.pi))
EPSILON = 1e-6  # as in Stable-Baselines3's SquashedDiagGaussianDistribution


class SACUpdate:
    """The update of a model's networks and entropy coefficient."""

    def __init__(self, model: Any) -> None:
        actor = model.actor
        self.critics = Critics(model)
        self.body = MLP(actor.latent_pi)
        self.mean = MLP([actor.mu])
        self.log_std = MLP([actor.log_std])
        flat = FlatTensors(tensors_of([self.body, self.mean, self.log_std]))
        self.adam = Adam(actor.optimizer, flat)
        self.ent_coef_adam: Adam | None = None
        if model.ent_coef_optimizer is not None:
            self.ent_coef_adam = Adam(model.ent_coef_optimizer, FlatTensors([model.log_ent_coef]))

    def run(self, model: Any, gradient_steps: int, batch_size: int) -> dict[str, float]:
        """Do `gradient_steps` updates and return the means of what Stable-Baselines3 logs."""
        history: list[tuple[torch.Tensor, ...]] = []
        for step, batch in enumerate(sample_minibatches(model, gradient_steps, batch_size)):
            history.append(self._step(model, batch))
            if step % model.target_update_interval == 0:
                self.critics.polyak_update(model.tau)
        model._n_updates += gradient_steps
        return self._losses(model, history)

    def _step(self, model: Any, minibatch: Minibatch) -> tuple[torch.Tensor, ...]:
        """Do one update.

        Returns:
            What the losses are computed from: the entropy coefficient, shape (1,), log
            probabilities and values of the actor's actions, shape (batch, 1), and the errors of the
            critics, shape (critics, batch, 1).
        """
        features, actions, rewards, discounts, _ = minibatch  # the signs are for TD3's target noise
        n, n_actions = actions.shape
        noise = torch.empty((2, n, n_actions), dtype=features.dtype)
        noise[0].normal_()  # one after the other, as Stable-Baselines3 samples them
        noise[1].normal_()

        # States and next states share the actor: one pass for both.
        values = self.body.forward(features)
        hidden = values[-1].relu_()
        mean = self.mean.forward(hidden)[-1]
        log_std = self.log_std.forward(hidden)[-1]
        policy = _squash(mean, log_std, noise.flatten(0, 1))
        log_prob = policy.log_prob[:n]
        ent_coef = self._update_ent_coef(model, log_prob)

        inputs = torch.cat((features, policy.actions), 1)
        next_value = self.critics.target_value(inputs[n:]) - ent_coef * policy.log_prob[n:]
        target = rewards + discounts * next_value
        errors = self.critics.update(torch.cat((features[:n], actions), 1), target, weight=0.5)

        value, grad_action = self.critics.value_and_gradient(inputs[:n], n_actions)
        grad_mean, grad_log_std = policy.first(n).backward(grad_action, ent_coef * (1 / n))
        self._update_actor([value[:n] for value in values], grad_mean, grad_log_std)
        return ent_coef, log_prob, value, errors

    def _update_actor(
        self, values: list[torch.Tensor], grad_mean: torch.Tensor, grad_log_std: torch.Tensor
    ) -> None:
        """Pass the gradients with respect to both heads' outputs to the body, and take a step."""
        gradients = self.adam.gradients
        hidden = values[-1]
        self.mean.backward([hidden], grad_mean, gradients[-4:-2])
        self.log_std.backward([hidden], grad_log_std, gradients[-2:])

        by_mean = self.mean.input_gradient([], grad_mean)
        by_log_std = self.log_std.input_gradient([], grad_log_std)
        grad_body = torch.ops.aten.threshold_backward(by_mean + by_log_std, hidden, 0)
        self.body.backward(values, grad_body, gradients[:-4])
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

    def _losses(self, model: Any, history: list[tuple[torch.Tensor, ...]]) -> dict[str, float]:
        """Return mean entropy coefficient and losses of several updates, computed at once."""
        ent_coef, log_prob, value, errors = map(torch.stack, zip(*history, strict=True))
        means = {
            "ent_coef": ent_coef.mean(),
            "actor_loss": (ent_coef.unsqueeze(2) * log_prob - value).mean(),
            "critic_loss": 0.5 * errors.square().mean((0, 2, 3)).sum(),
        }
        if self.ent_coef_adam is not None:
            surplus = log_prob.mean((1, 2)) + model.target_entropy
            means["ent_coef_loss"] = -(ent_coef.squeeze(1).log() * surplus).mean()
        return {name: mean.item() for name, mean in means.items()}


class _SquashedGaussian(NamedTuple):
    """Actions of a Gaussian policy squashed by tanh, and their log probabilities.

    The operations and their order are as in Stable-Baselines3 and torch.distributions. Terms
    that cancel but for rounding are kept, since Adam's first steps magnify rounding.

    All have the shape (n, actions), `log_prob` (n, 1).
    """

    actions: torch.Tensor
    log_prob: torch.Tensor
    noise: torch.Tensor
    raw_log_std: torch.Tensor
    std: torch.Tensor
    offset: torch.Tensor  # from the mean, before tanh
    double_variance: torch.Tensor

    def first(self, n: int) -> "_SquashedGaussian":
        """Return the first n."""
        return _SquashedGaussian(*[tensor[:n] for tensor in self])

    def backward(
        self, grad_action: torch.Tensor, grad_log_prob: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the gradients with respect to the mean and the raw log standard deviation.

        Both have the shape (n, actions).

        Args:
            grad_action: gradient of the loss with respect to the actions, without their effect on
                `log_prob`, shape (n, actions).
            grad_log_prob: gradient of the loss with respect to each log probability, one number.
        """
        actions, _, noise, raw_log_std, std, offset, double_variance = self
        density = 1 - actions**2 + EPSILON
        grad_square = -grad_log_prob / double_variance
        grad_offset = grad_square * 2 * offset
        grad_squashed = grad_log_prob / density * (2 * actions) + grad_action
        grad_sample = torch.ops.aten.tanh_backward(grad_squashed, actions) + grad_offset
        grad_double_variance = -grad_log_prob * (-(offset**2) / double_variance / double_variance)
        by_variance = (grad_double_variance * 2) * (2 * std)
        grad_std = -grad_log_prob / std + by_variance + grad_sample * noise
        inside = (raw_log_std >= LOG_STD_MIN) & (raw_log_std <= LOG_STD_MAX)
        return grad_sample - grad_offset, grad_std * std * inside


def _squash(
    mean: torch.Tensor, raw_log_std: torch.Tensor, noise: torch.Tensor
) -> _SquashedGaussian:
    """Sample actions from the outputs of an actor and standard normal noise, shape (n, actions)."""
    std = raw_log_std.clamp(LOG_STD_MIN, LOG_STD_MAX).exp_()
    sample = mean + noise * std
    actions = torch.tanh(sample)
    offset = sample - mean
    double_variance = 2 * std**2
    density = 1 - actions**2 + EPSILON
    log_prob = (-(offset**2) / double_variance - std.log() - LOG_SQRT_2_PI).sum(1)
    log_prob = (log_prob - density.log().sum(1)).unsqueeze(1)
    return _SquashedGaussian(actions, log_prob, noise, raw_log_std, std, offset, double_variance)


class SAC(FastTraining, stable_baselines3.SAC):
    """Stable-Baselines3's SAC with a faster `train`, which computes the same."""

    update_class = SACUpdate
