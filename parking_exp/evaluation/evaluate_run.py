"""Evaluate stored runs: rates with intervals, a table of episodes, a video, a replay."""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from parking_exp.config.cell_labels import find_factors, label_factors
from parking_exp.config.paths import resolved
from parking_exp.config.run_key import short_hash
from parking_exp.config.settings import Setting, display_setting, flatten_config, with_defaults
from parking_exp.config.validate import raise_problems
from parking_exp.dotted_paths import import_object
from parking_exp.errors import ConfigError, VideoError
from parking_exp.evaluation.agents import Agent, find_agents
from parking_exp.evaluation.evaluation_request import (
    EvaluationRequest,
    choose_env,
    validate_evaluation,
)
from parking_exp.evaluation.sb3_model_files import find_agent_in_file, is_model_file
from parking_exp.phrases import plural
from parking_exp.runs.atomic_files import write_atomically
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.file_hashes import write_summary
from parking_exp.runs.metric_logs import EPISODES_FILE
from parking_exp.runs.run_files import EVALUATIONS, SUMMARY_FILE, VIDEO_FILE
from parking_exp.tasks.registry import EnvConfig, make_task
from parking_exp.tasks.task import Policy, Task
from parking_exp.terminal import say

REPLAY_FILE = "replay.html"


@dataclass(frozen=True)
class Evaluation:
    """An agent, and what it is evaluated on."""

    request: EvaluationRequest
    agent: Agent
    env: EnvConfig

    @property
    def folder(self) -> Path:
        """Folder of the results."""
        return self.agent.folder / EVALUATIONS / (self.request.name or self.default_name)

    @property
    def default_name(self) -> str:
        """Name of the folder if the request has none."""
        env = self.env
        seeds = self.request.seeds
        name = f"{env.name}-{self.request.model}-seeds-{seeds[0]}-{seeds[-1]}"
        if env.simulator != env.reference_simulator:
            name += f"-{env.simulator}"
        if self.changes:
            # the same option with other values is another evaluation
            name += f"-{short_hash(env.model_dump())}"
        return name

    @property
    def env_text(self) -> str:
        """Name of the env, with changes to the training env in brackets."""
        changes = self.changes
        if not changes or "name" in changes:
            return self.env.name
        texts = [f"{key}={display_setting(value)}" for key, value in changes.items()]
        return f"{self.env.name} ({', '.join(texts)})"

    @property
    def changes(self) -> dict[str, Any]:
        """Keys of `env` that differ from the training env, with their values."""
        now = _env_settings(self.env)
        before = _env_settings(self.agent.config.env)
        differing = [key for key in now | before if now.get(key) != before.get(key)]
        return {key.removeprefix("env."): now.get(key) for key in differing}


def _env_settings(env: EnvConfig) -> dict[str, Setting]:
    """Return the settings that can change an env's episodes, without the keys of the agent."""
    plain = {"env": env.model_dump(exclude={"simulator", "metrics", *env.agent_keys})}
    return with_defaults(flatten_config(plain))


def evaluate_runs(
    configs: Sequence[DictConfig], on_saved: Callable[[EvaluationRequest, RunDirectory], None]
) -> None:
    """Evaluate the agents that each config names; several evaluations make a table.

    `on_saved` is called with the directory of a run that has new results, and their request.
    """
    requests = [validate_evaluation(config) for config in configs]
    evaluations = _find_evaluations(requests)
    folders = {resolved(evaluation.folder) for evaluation in evaluations}
    if len(folders) < len(evaluations):
        raise ConfigError(
            "two of these evaluations would share a folder; leave name out, and name each run once"
        )

    summaries = []
    for evaluation in evaluations:
        summaries.append(_evaluate(evaluation))
        directory = evaluation.agent.directory
        if directory is not None:
            on_saved(evaluation.request, directory)
        say(f"results        {evaluation.folder}")
    if len(evaluations) > 1:
        say("", *_summary_table(evaluations, summaries).split("\n"))


def _find_evaluations(requests: Sequence[EvaluationRequest]) -> list[Evaluation]:
    """Return each agent that is asked for, with the env that it is evaluated on.

    Raises:
        ConfigError: an agent can't be evaluated on its env, or the env is wrong.
    """
    find = cache(find_agents)  # once, for all the envs that they are evaluated on
    evaluations = []
    for request in requests:
        run = request.run
        if is_model_file(run):
            env = request.env or {}
            agents = [find_agent_in_file(run, request.output_path, env, request.algorithm or {})]
        else:
            agents = find(run, request.output_path, request.model, trust=request.trust)
        for agent in agents:
            evaluated_on = choose_env(request, agent)
            if not agent.config.is_trained:
                raise_problems(import_object(agent.config.algorithm.target).problems(evaluated_on))
            evaluations.append(Evaluation(request, agent, evaluated_on))
    _check_envs(evaluations)
    return evaluations


def _check_envs(evaluations: Sequence[Evaluation]) -> None:
    """Check each env once for all its agents: making one may take seconds."""
    envs = {evaluation.env.model_dump_json(): evaluation.env for evaluation in evaluations}
    for env in envs.values():
        raise_problems(env.problems())
        with closing(make_task(env)) as task:
            raise_problems(task.problems())


def _summary_table(evaluations: Sequence[Evaluation], summaries: Sequence[dict[str, float]]) -> str:
    """Return a table of mean rates by cell and evaluation, with the lowest success of a run."""
    import pandas as pd

    labels = _env_labels(evaluations)
    rows = []
    for evaluation, label, summary in zip(evaluations, labels, summaries, strict=True):
        row: dict[str, Any] = {
            "agent": evaluation.agent.label,
            "results": evaluation.folder.name,
            "evaluated on": label,
        }
        for key, value in summary.items():
            if key.endswith("_rate"):
                row[key.removesuffix("_rate")] = 100 * value
        rows.append(row)
    groups = pd.DataFrame(rows).groupby(["agent", "results", "evaluated on"], sort=False)
    table = groups.mean().add_suffix(", %")
    table.insert(0, "runs", groups.size())
    table.insert(2, "lowest success, %", groups["success"].min())
    return table.reset_index().to_string(index=False, float_format="{:.2f}".format, na_rep="")


def _env_labels(evaluations: Sequence[Evaluation]) -> list[str]:
    """Return how the env of each evaluation differs from the others, and from the training env."""
    envs = [evaluation.env for evaluation in evaluations]
    envs += [evaluation.agent.config.env for evaluation in evaluations]
    factors, values = find_factors([_env_settings(env) for env in envs])
    labels = [label_factors(factors, row) or "env of training" for row in values]
    return labels[: len(evaluations)]


def _evaluate(evaluation: Evaluation) -> dict[str, float]:
    """Evaluate an agent, print and write the results, and return the rates and means."""
    from parking_exp.algorithms.torch_settings import torch_settings
    from parking_exp.evaluation.evaluate_policy import (
        describe_episodes,
        evaluate_policy,
        rate_intervals,
        summarise,
    )
    from parking_exp.evaluation.evaluation_progress import evaluation_progress

    request = evaluation.request
    agent = evaluation.agent
    folder = evaluation.folder
    if agent.directory is not None:
        say(f"run directory  {agent.directory.path}")
    with closing(make_task(evaluation.env)) as task, torch_settings(agent.config):
        policy = agent.policy(task)
        with evaluation_progress(len(request.seeds), evaluation.env.name) as show:
            episodes = evaluate_policy(policy, task, request.seeds, show)

        _clear_folder(folder)
        episodes.to_csv(folder / EPISODES_FILE, index=False)
        say(_headline(evaluation), *describe_episodes(episodes, task.metrics))
        if request.video:
            _write_video(policy, task, request, folder)
        if request.replay:
            _write_replay(policy, task, evaluation)

    summary = summarise(episodes, task.metrics)
    _write_summary(evaluation, summary, rate_intervals(episodes, task.metrics))
    return summary


def _clear_folder(folder: Path) -> None:
    """Make the folder of an evaluation, without the results of an earlier one."""
    folder.mkdir(parents=True, exist_ok=True)
    for outdated in (folder / SUMMARY_FILE, folder / REPLAY_FILE, *folder.glob("video.*")):
        outdated.unlink(missing_ok=True)


def _headline(evaluation: Evaluation) -> str:
    """Say what is evaluated, and on what."""
    first = evaluation.request.first_scene
    simulator = evaluation.env.simulator
    return f"{_title(evaluation)}, from seed {first}, simulated by {simulator}"


def _title(evaluation: Evaluation) -> str:
    """Name the agent, the number of episodes and the env."""
    episodes = plural(len(evaluation.request.seeds), "episode")
    return f"{evaluation.agent.name} on {episodes} of {evaluation.env_text}"


def _write_summary(
    evaluation: Evaluation, summary: dict[str, float], bounds: dict[str, tuple[float, float]]
) -> None:
    """Write the summary of an evaluation, with the intervals of its rates."""
    request = evaluation.request
    env = evaluation.env
    entries = {
        "env": env.name,
        "env_config": env.model_dump(),
        "simulator": env.simulator,
        "model": request.model,
        "first_scene": request.first_scene,
        "episodes": len(request.seeds),
        **summary,
        "intervals": bounds,
    }
    write_summary(evaluation.folder, entries)


def _write_video(policy: Policy, task: Task, request: EvaluationRequest, folder: Path) -> None:
    """Record the first episodes, and say where; a machine that can't render makes no video."""
    from parking_exp.evaluation.video import record_video

    seeds = request.seeds[: request.video]
    reason = record_video(policy, task, seeds, folder / VIDEO_FILE, request.gif)
    if reason is not None:
        say(reason)
    for path in sorted(folder.glob("video.*")):
        say(f"video          {path}")


def _write_replay(policy: Policy, task: Task, evaluation: Evaluation) -> None:
    """Write the page that plays all episodes, and say where; most tasks have none."""
    path = evaluation.folder / REPLAY_FILE
    try:
        page = task.replay_page(policy, evaluation.request.seeds, _title(evaluation))
    except VideoError as error:
        say(str(error))
        return
    write_atomically(path, page)
    say(f"replay         {path}")
