"""Model files of plain Stable-Baselines3 (`model.save("model.zip")`) as agents.

Nothing in a file is executed. The weights of the actor are loaded as torch's `weights_only`, and
give the sizes of its layers. The pickled parts of `data` are not read, only its JSON.
"""

import json
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from parking_exp.config.allowlist import ALLOWED
from parking_exp.config.compose import compose_configs
from parking_exp.config.constructor_arguments import argument_problems
from parking_exp.config.paths import absolute_path, refuse_links
from parking_exp.config.run_key import short_hash
from parking_exp.config.schema import RunConfig
from parking_exp.config.validate import SWEEP_KEYS, parse_plain, raise_problems
from parking_exp.errors import ModelError, RunNotFoundError, one_line
from parking_exp.evaluation.agents import Agent
from parking_exp.runs.foreign_files import MAX_JSON, open_file, sha256

SB3_EVALUATIONS = "models"
"""Folder of an output directory with the evaluations of model files."""
OPTIONAL_ARGUMENTS = {
    "net_arch",  # as the weights have it
    "activation_fn",
    "use_sde",
    "n_critics",
    "share_features_extractor",
    "optimizer_class",
    "optimizer_kwargs",
    "log_std_init",
    "use_expln",
}
"""Arguments of policies that need not be passed.

The file has them, or they do not change deterministic actions.
"""
ACTIVATION = re.compile(r"<class 'torch\.nn\.modules\.activation\.(\w+)'>")


def is_model_file(run: str) -> bool:
    """Return whether a name means a model file."""
    return run.endswith(".zip") and not absolute_path(run).is_dir()


def find_agent_in_file(
    run: str, output_dir: Path, env: Mapping[str, Any], algorithm: Mapping[str, Any]
) -> Agent:
    """Return the agent in a model file.

    Args:
        run: path of the file.
        output_dir: where its evaluations are written.
        env: the `env` group that it is evaluated on.
        algorithm: keys of the `algorithm` group that the user set. The class and the arguments of
            the policy that are not set come from the file, if they can be read safely.

    Raises:
        ConfigError: the policy refuses its arguments.
        ModelError: the file is damaged, or its policy has arguments that have to be passed.
        RunNotFoundError: there is no such file.
    """
    from parking_exp.algorithms.model_files import read_actor

    path = absolute_path(run)
    if not path.is_file():
        raise RunNotFoundError(f"run={run}: there is no such file")
    is_gaussian, net_arch = _architecture(path, read_actor(path, "cpu"))
    # DDPG's policy is TD3's.
    default_class = f"parking_exp.algorithms.{'SAC' if is_gaussian else 'TD3'}"
    stored = _read_data(path)
    arguments = {
        "name": "saved",
        "_target_": algorithm.get("_target_", default_class),
        "features": "raw",
        "normalize": False,
        "policy_ema_half_life": None,
        "net_arch": net_arch,
        "policy_kwargs": _policy_kwargs(path, stored, algorithm.get("policy_kwargs", {})),
    }
    if stored.get("use_sde") is True:
        arguments["use_sde"] = True

    (recipe,) = compose_configs("config", [])
    plain: Any = OmegaConf.to_container(recipe, resolve=True)
    plain.update(env=env, algorithm=arguments, output_dir=str(output_dir))
    config = parse_plain(RunConfig, {key: plain[key] for key in plain if key not in SWEEP_KEYS})
    raise_problems(argument_problems(config))

    digest = short_hash({"file": sha256(path), "env": env, "algorithm": arguments})
    folder = output_dir / SB3_EVALUATIONS / f"{path.stem}-{digest}"
    refuse_links([folder.parent, folder, *folder.rglob("*")], output_dir)
    return Agent(run, config, path, folder)


def _architecture(path: Path, weights: Mapping[str, Any]) -> tuple[bool, list[int]]:
    """Return whether an actor is SAC's, and the sizes of its hidden layers."""
    is_gaussian = "latent_pi.0.weight" in weights
    layer = re.compile(r"latent_pi\.\d+\.weight" if is_gaussian else r"mu\.\d+\.weight")
    sizes = []
    for name, weight in weights.items():
        if layer.fullmatch(name) and weight.ndim == 2:
            sizes.append(len(weight))
    if not is_gaussian:
        sizes = sizes[:-1]  # the last layer gives the actions
    if not sizes:
        raise ModelError(f"{path} has no policy of SAC, TD3 or DDPG with hidden layers")
    return is_gaussian, sizes


def _read_data(path: Path) -> dict[str, Any]:
    """Return the JSON of a model file, in which pickled values are text."""
    try:
        with open_file(path) as file, zipfile.ZipFile(file) as archive:
            if archive.getinfo("data").file_size > MAX_JSON:
                raise ValueError(f"data has more than {MAX_JSON:,} bytes")
            data = json.loads(archive.read("data"))
            if not isinstance(data, dict):
                raise ValueError("data is not a JSON object")
    except Exception as error:  # damaged bytes make zipfile raise anything
        raise ModelError(f"{path} is damaged ({one_line(error)})") from error
    return data


def _policy_kwargs(
    path: Path, stored: Mapping[str, Any], chosen: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the arguments of a file's policy: those that the user chose, and its activation.

    Raises:
        ModelError: the policy was made with another argument, which the user did not choose.
    """
    made_with = stored.get("policy_kwargs")
    if not isinstance(made_with, dict):
        made_with = {}
    arguments = dict(chosen)
    unknown = made_with.keys() - OPTIONAL_ARGUMENTS - arguments.keys()

    activation = made_with.get("activation_fn")
    if activation is not None and "activation_fn" not in arguments:
        match = ACTIVATION.fullmatch(str(activation))
        activation_path = f"torch.nn.{match[1]}" if match else None
        if activation_path in ALLOWED:
            arguments["activation_fn"] = activation_path
        else:
            unknown.add("activation_fn")

    for name in sorted(unknown):
        if not name.startswith(":"):  # `:type:` and `:serialized:` describe a pickled dict
            raise ModelError(
                f"{path} was trained with policy_kwargs {name}={one_line(made_with[name])}, which "
                f"is pickled there; pass algorithm.policy_kwargs.{name}=VALUE"
            )
    return arguments
