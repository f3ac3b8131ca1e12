"""Which models the fast update supports."""

from typing import Any, cast

from stable_baselines3.common.policies import ContinuousCritic
from stable_baselines3.common.torch_layers import CombinedExtractor, FlattenExtractor
from stable_baselines3.sac.policies import Actor as GaussianActor
from stable_baselines3.td3.policies import Actor as DeterministicActor
from torch import nn

from parking_exp.algorithms.fast.mlp import linear_layers
from parking_exp.algorithms.fast.optimizer import is_plain_adam
from parking_exp.algorithms.features import EgoFrameExtractor, FineEgoFrameExtractor, MirroredEgoFrameExtractor
from parking_exp.algorithms.mirrored_policies import MirroredActor, MirroredCritic, MirroredGaussianActor

EXTRACTORS = (EgoFrameExtractor, FineEgoFrameExtractor, MirroredEgoFrameExtractor, CombinedExtractor, FlattenExtractor)


def is_supported(model: Any) -> bool:
    """Whether the fast update supports everything in a SAC, TD3 or DDPG model.

    It supports Stable-Baselines3's own actors and critics, our mirrored ones, MLPs with ReLU, features without
    parameters, plain Adam and the CPU; not gSDE.
    """
    actor, critic = model.actor, model.critic
    mirrored = type(critic) is MirroredCritic
    if not (mirrored or type(critic) is ContinuousCritic) or getattr(model, "use_sde", False):
        return False
    if type(actor) is (MirroredGaussianActor if mirrored else GaussianActor):
        known = linear_layers(actor.latent_pi) and type(actor.mu) is type(actor.log_std) is nn.Linear
    else:
        deterministic = type(actor) is (MirroredActor if mirrored else DeterministicActor)
        known = deterministic and linear_layers(actor.mu, last=nn.Tanh)
    ent_coef_optimizer = getattr(model, "ent_coef_optimizer", None)
    return bool(
        known
        and all(linear_layers(cast(nn.Sequential, network)) for network in critic.q_networks)
        and all(type(network.features_extractor) in EXTRACTORS for network in (actor, critic))
        and type(actor.features_extractor) is type(critic.features_extractor)
        and all(_is_fully_trained(network) for network in (actor, critic))
        and (ent_coef_optimizer is None or is_plain_adam(ent_coef_optimizer))
    )


def _is_fully_trained(network: Any) -> bool:
    """Whether plain Adam trains all of a network's parameters, and its features extractor has none."""
    if not is_plain_adam(network.optimizer) or next(network.features_extractor.parameters(), None) is not None:
        return False
    (group,) = network.optimizer.param_groups
    return {id(tensor) for tensor in group["params"]} == {id(tensor) for tensor in network.parameters()}
