"""Find the agent that a run starts from, which the key `init` names."""

from contextlib import suppress
from pathlib import Path

from parking_exp.config.paths import absolute_path, relative_path
from parking_exp.config.schema import RunConfig
from parking_exp.errors import ConfigError, RunNotFoundError
from parking_exp.evaluation.agents import Agent, find_agent, is_pretrained
from parking_exp.phrases import list_names
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.lookup import LATEST, find_runs


def pin_source(config: RunConfig) -> RunConfig:
    """Return a config whose `init` always means the same run.

    `init` becomes the run's path, relative if it is in the output directory. `latest` becomes the
    run that it meant when this config was first planned, so a repeated command resumes its runs.

    Raises:
        RunNotFoundError: there is no such run.
    """
    if config.init is None or is_pretrained(config.init):
        return config
    if config.init != LATEST:
        return config.model_copy(update={"init": _source_path(config.init, config.output_path)})
    source = _planned_source(config)
    if source is None:
        folder = find_agent(LATEST, config.output_path, trust=True, key="init").folder
        source = relative_path(folder, config.output_path)
    return config.model_copy(update={"init": source, "init_latest": True})


def _planned_source(config: RunConfig) -> str | None:
    """Return the run that `latest` meant when this config was planned; None if it never was."""
    for path in find_runs(config.output_path, config.experiment_name):
        with suppress(ConfigError):  # it is damaged
            planned = RunDirectory(path).read_config()
            as_typed = planned.model_copy(update={"init": LATEST})
            if planned.init_latest and as_typed.cell_key == config.cell_key:
                return planned.init
    return None


def _source_path(init: str, output_path: Path) -> str:
    """Return the path of a run or a cell, relative to the output directory if it lies there."""
    folder = output_path / init
    if not folder.is_dir():
        folder = absolute_path(init)
    if not folder.is_dir():
        try:
            folder = find_agent(init, output_path, trust=True, key="init").folder
        except RunNotFoundError:
            # A path is accepted even if nothing is there: a run that has begun does not need its
            # source any more.
            if not (Path(init).is_absolute() or folder.is_relative_to(output_path)):
                raise
    return relative_path(folder, output_path)


def find_source(config: RunConfig) -> Agent:
    """Return the agent that a run starts from; if `init` is a cell, its run with the same seed.

    Nothing in its config is executed, since only its weights are loaded.

    Raises:
        RunNotFoundError: there is no such run, or it has no final model yet.
    """
    source = str(config.init)
    if not is_pretrained(source):
        folder = config.output_path / source
        seed_folder = folder / f"seed={config.seed}"
        if seed_folder.is_dir():
            folder = seed_folder
        elif seeds := sorted(path.name for path in folder.glob("seed=*")):
            raise RunNotFoundError(
                f"init={source}: this cell has no run with seed {config.seed}; it has "
                f"{list_names(seeds)}"
            )
        source = str(folder)
    return find_agent(source, config.output_path, trust=True, key="init")
