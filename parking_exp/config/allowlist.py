"""Allow-list of classes that a stored config may instantiate, since it may come from anywhere."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from parking_exp.config.constructor_arguments import CLASS_ARGUMENTS, class_path
from parking_exp.config.schema import RunConfig
from parking_exp.config.signatures import defined_in
from parking_exp.config.source_lookup import UnknownTarget
from parking_exp.errors import UntrustedError

# Packages and modules whose classes a run is made of. To construct one of them does nothing but make an object; other
# modules of these projects have classes that write files or start processes (Stable-Baselines3's loggers and VecEnvs).
TRUSTED = (
    "highway_env.vehicle",
    "parking_exp.buffers",
    "parking_exp.algorithms.crossq",
    "parking_exp.algorithms.features",
    "parking_exp.algorithms.fast",
    "sb3_contrib.crossq",
    "sb3_contrib.tqc",
    "stable_baselines3.common.buffers",
    "stable_baselines3.common.noise",
    "stable_baselines3.common.policies",
    "stable_baselines3.common.torch_layers",
    "stable_baselines3.common.utils",
    "stable_baselines3.ddpg",
    "stable_baselines3.her",
    "stable_baselines3.sac",
    "stable_baselines3.td3",
    "torch.nn",
    "torch.optim",
)


def check_trust(config: RunConfig, source: Path) -> None:
    """Refuse a stored config that would execute something else than the classes a run is made of.

    Sources are read and nothing of them is imported.

    Raises:
        UntrustedError: it has a `_target_` that is no such class.
    """
    vehicles = ("env.other_vehicles_type", config.env.other_vehicles_type)  # highway-env imports and calls it, too
    for key, target in [*_targets(config.plain()), vehicles]:
        if not is_trusted(target):
            raise UntrustedError(
                f"{key}={target} in {source} is not on the allow-list; evaluating this run would execute it "
                "(trust=true allows it)"
            )


def is_trusted(target: object) -> bool:
    """Whether a `_target_` is the dotted path of a class that is defined in one of the `TRUSTED` modules."""
    if not isinstance(target, str) or not all(part.isidentifier() for part in target.split(".")):
        return False
    if target.partition(".")[0] not in {trusted.partition(".")[0] for trusted in TRUSTED}:
        return False  # another package that has imported such a class
    try:
        module = defined_in(target)
    except UnknownTarget:
        return False
    return any(module == trusted or module.startswith(f"{trusted}.") for trusted in TRUSTED)


def _targets(node: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield everything in nested containers that is imported: each `_target_` and each class argument, with its key."""
    is_sequence = isinstance(node, list | tuple | set)
    children = node.items() if isinstance(node, Mapping) else enumerate(node) if is_sequence else ()
    for name, value in children:
        path = f"{key}.{name}" if key else str(name)
        if name == "_target_":
            yield path, class_path(node)
        elif name in CLASS_ARGUMENTS and isinstance(value, str):
            yield path, value
        else:
            yield from _targets(value, path)
