"""Allow-list of classes that a stored config may instantiate, since it may come from anywhere.

Only names are compared: nothing is imported.
"""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from parking_exp.config.constructor_arguments import CLASS_ARGUMENTS, class_path
from parking_exp.config.schema import RunConfig
from parking_exp.errors import UntrustedError

# Module -> classes, under each name that a config may use. Their constructors have no side effects.
CLASSES = {
    "parking_exp.algorithms": ["DDPG", "SAC", "TD3"],
    "parking_exp.algorithms.action_noise": ["EpsilonRandomActionNoise"],
    "parking_exp.algorithms.crossq": ["CrossQ"],
    "parking_exp.tasks.parking.features": [
        "EgoFrameExtractor",
        "FineEgoFrameExtractor",
        "MirroredEgoFrameExtractor",
    ],
    "parking_exp.tasks.parking.planning": ["Planner"],
    "parking_exp.buffers": ["HerBuffer"],
    "sb3_contrib": ["CrossQ", "TQC"],
    "stable_baselines3": ["DDPG", "HerReplayBuffer", "SAC", "TD3"],
    "stable_baselines3.common.buffers": ["DictReplayBuffer", "ReplayBuffer"],
    "stable_baselines3.common.noise": ["NormalActionNoise", "OrnsteinUhlenbeckActionNoise"],
    "stable_baselines3.common.torch_layers": ["CombinedExtractor", "FlattenExtractor", "NatureCNN"],
    "stable_baselines3.common.utils": ["ConstantSchedule", "LinearSchedule"],
    "stable_baselines3.her": ["HerReplayBuffer"],
    "torch.nn": [
        "CELU", "ELU", "GELU", "Hardsigmoid", "Hardswish", "Hardtanh", "Identity", "LeakyReLU",
        "LogSigmoid", "Mish", "PReLU", "RReLU", "ReLU", "ReLU6", "SELU", "SiLU", "Sigmoid",
        "Softplus", "Softsign", "Tanh", "Tanhshrink",
    ],
    "torch.optim": [
        "ASGD", "Adadelta", "Adafactor", "Adagrad", "Adam", "AdamW", "Adamax", "Muon", "NAdam",
        "RAdam", "RMSprop", "Rprop", "SGD",
    ],
}  # fmt: skip
ALLOWED = frozenset(f"{module}.{name}" for module, names in CLASSES.items() for name in names)


def check_trust(config: RunConfig, source: Path) -> None:
    """Refuse a stored config that names a class outside the allow-list.

    `source` is the file of the config, for the message.

    Raises:
        UntrustedError: a class or `_target_` is not on the list.
    """
    unlisted = unlisted_class(config)
    if unlisted is not None:
        raise UntrustedError(
            f"{unlisted} in {source} is not on the allow-list, and the run was not trained here; "
            "trust=true (in Python trust=True) allows it, if you trust its author"
        )


def unlisted_class(config: RunConfig) -> str | None:
    """Return the first `key=class` of a config that is not on the allow-list, or None."""
    imported = [(f"env.{key}", path) for key, path in config.env.imports.items()]
    for key, target in [*_targets(config.plain()), *imported]:
        if not isinstance(target, str) or target not in ALLOWED:
            return f"{key}={target}"
    return None


def _targets(node: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield what nested containers would import, with its key: `_target_` and class arguments."""
    children: Iterable[tuple[Any, Any]] = ()
    if isinstance(node, Mapping):
        children = node.items()
    elif isinstance(node, list | tuple | set):
        children = enumerate(node)
    for name, value in children:
        path = f"{key}.{name}" if key else str(name)
        if name == "_target_":
            yield path, class_path(node)
        elif name in CLASS_ARGUMENTS and isinstance(value, str):
            yield path, value
        else:
            yield from _targets(value, path)
