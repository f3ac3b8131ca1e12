"""Find the agent that a run starts from, which the key `init` names."""

from contextlib import suppress

from parking_exp.config.paths import directory_path, relative_path
from parking_exp.config.schema import RunConfig
from parking_exp.errors import ConfigError, RunNotFoundError
from parking_exp.evaluation.agents import (
    PRETRAINED,
    Agent,
    find_agent,
    is_pretrained,
    pretrained_name,
)
from parking_exp.runs.lookup import LATEST, find_runs
from parking_exp.runs.run_files import read_config


def name_source(config: RunConfig) -> RunConfig:
    """Return a config whose `init` always means the same run: its path in the output directory.

    The path is absolute if the run lies elsewhere; pretrained agents keep their names. `latest` is
    what it was when this config was planned first, so that a repeated command resumes its runs.

    Raises:
        RunNotFoundError: there is no such run.
    """
    if config.init is None:
        return config
    if is_pretrained(config.init):
        name = f"{PRETRAINED}/{pretrained_name(config.init)}"
        return config.model_copy(update={"init": name})
    if config.init == LATEST:
        place = _planned_source(config) or _place(config)
        return config.model_copy(update={"init": place, "init_latest": True})
    return config.model_copy(update={"init": _place(config)})


def _planned_source(config: RunConfig) -> str | None:
    """Return what `latest` was when runs of this config were planned; None if none were."""
    for path in find_runs(config.output_path, config.experiment_name):
        with suppress(ConfigError):  # it is damaged
            planned = read_config(path, config.output_path)
            as_asked = planned.model_copy(update={"init": LATEST})
            if planned.init_latest and as_asked.cell_key == config.cell_key:
                return planned.init
    return None


def _place(config: RunConfig) -> str:
    """Return where the run or cell of `init` is; one that was deleted may be in the output
    directory.
    """
    assert config.init is not None
    output_path = config.output_path
    typed = directory_path(config.init)
    for folder in (output_path / config.init, typed):
        if folder.is_dir():
            return relative_path(folder, output_path)
    try:
        folder = find_agent(config.init, output_path, trust=True, key="init").folder
    except RunNotFoundError:
        if not typed.is_relative_to(output_path):
            raise
        folder = typed  # which a run that has begun does not need
    return relative_path(folder, output_path)


def find_source(config: RunConfig) -> Agent:
    """Return the agent that a run starts from; of a cell, that of the run's own seed.

    Nothing in its config is executed: only its weights are loaded.

    Raises:
        RunNotFoundError: there is no such run, or it has no final model yet.
    """
    assert config.init is not None
    if is_pretrained(config.init):
        return find_agent(config.init, config.output_path, key="init")
    folder = config.output_path / config.init
    of_seed = folder / f"seed={config.seed}"
    if of_seed.is_dir():
        folder = of_seed
    return find_agent(str(folder), config.output_path, trust=True, key="init")
