"""Save and load model files: zips as Stable-Baselines3 saves them.

The pickled part of a file is not read, and tensors are loaded as torch's `weights_only`: nothing in
it is executed.
"""

import io
import re
import time
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import torch
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.save_util import load_from_zip_file, recursive_getattr

from parking_exp.errors import ModelError, one_line
from parking_exp.runs.atomic_files import read_file, replacing

EARLIEST, LATEST = (1980, 1, 1, 0, 0, 0), (2107, 12, 31, 23, 59, 58)
# Pickled entries for which `SAC.load` would require an env, because of the HER buffer.
BUFFER_ENTRIES = ("replay_buffer_class", "replay_buffer_kwargs")


def save_model(model: OffPolicyAlgorithm, path: Path) -> None:
    """Save a model so that Stable-Baselines3 can load it.

    Raises:
        OSError: the disk is full; an earlier file is untouched.
    """
    with replacing(path) as temporary:
        write_zip(model, temporary, exclude=BUFFER_ENTRIES)


def write_zip(model: OffPolicyAlgorithm, path: Path, exclude: Iterable[str] = ()) -> None:
    """Write a model with Stable-Baselines3, whatever the clock says: zip files have times from 1980
    to 2107 only.
    """
    now = time.localtime(time.time())
    possible = min(max(now[:6], EARLIEST), LATEST)
    if possible == now[:6]:
        model.save(path, exclude=exclude)
        return
    with patch.object(zipfile.time, "localtime", return_value=possible):  # type: ignore[attr-defined]
        model.save(path, exclude=exclude)


def load_weights(path: Path, model: OffPolicyAlgorithm) -> None:
    """Load all parameters, optimizers and other tensors of a model.

    Raises:
        ModelError: the file cannot be read, holds something other than weights, or is that of
            another model; some weights may have been loaded by then.
    """
    weights, variables = read_weights(path, model.device)
    _, names = model._get_torch_save_params()
    try:
        if set(variables) != set(names):
            raise ValueError(f"it has the tensors {sorted(variables)}, not {sorted(names)}")
        model.set_parameters(weights, device=model.device)
        with torch.no_grad():
            for name in names:
                recursive_getattr(model, name).copy_(variables[name])
    except (LookupError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        problem = one_line("".join(str(error).splitlines()[:2]))
        name = type(model).__name__
        raise ModelError(
            f"{path} does not fit {name} as its config.yaml describes it: {problem}"
        ) from error


def read_weights(path: Path, device: torch.device) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return all state dicts of a model file, and its single tensors, both by name.

    Raises:
        ModelError: bytes are missing or changed, or it holds something other than weights.
    """
    content = io.BytesIO(read_file(path))  # an error of the disk is not damage
    try:
        _, weights, variables = load_from_zip_file(content, load_data=False, device=device)
    except Exception as error:  # damaged bytes make zipfile and torch raise anything
        reason = re.split(r"\.\s|\n", str(error))[0] or type(error).__name__
        raise ModelError(f"{path} is damaged ({reason})") from error
    return weights, variables or {}
