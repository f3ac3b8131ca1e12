"""What the lean update knows."""

from typing import Any

from torch import nn

from parking_exp.lean.adam import is_plain
from parking_exp.lean.networks import linear_layers


def is_lean(model: Any) -> bool:
    """Whether the lean update knows everything in a SAC, TD3 or DDPG model.

    It knows perceptrons with ReLU, features that are computed and not learned, plain Adam, the CPU; not gSDE.
    """
    actor, critic = model.actor, model.critic
    optimizers = [actor.optimizer, critic.optimizer, getattr(model, "ent_coef_optimizer", None)]
    bodies = [*critic.q_networks, actor.latent_pi if hasattr(actor, "latent_pi") else actor.mu]
    return (
        not getattr(model, "use_sde", False)
        and all(optimizer is None or is_plain(optimizer) for optimizer in optimizers)
        and all(linear_layers(body) is not None for body in bodies)
        and type(actor.features_extractor) is type(critic.features_extractor)
        and _is_stateless(actor.features_extractor)
        and _is_stateless(critic.features_extractor)
    )


def _is_stateless(module: nn.Module) -> bool:
    """Whether a features extractor has nothing to learn or remember, so that all networks can share its output."""
    return next(module.parameters(), None) is None and next(module.buffers(), None) is None
