"""MLflow tags that describe experiments and runs in its UI: kind, description, command, headline result."""

import json

from parking_exp.config.schema import RunConfig
from parking_exp.runs.directory import RunDirectory

NOTE = "mlflow.note.content"
KIND = "mlflow.experimentKind"
VIEW = "mlflow.sharedViewState.results"  # a saved view of the UI, whose own table of runs has no metric
VIEW_COLUMNS = ["metrics.`final/success_rate`", "metrics.`final/crash_rate`", "metrics.`final/parked_rate`"]
MODEL_TRAINING = "custom_model_development"  # without it, the UI opens an experiment as one of GenAI: traces, prompts


def experiment_tags(name: str) -> dict[str, str]:
    """Return MLflow's own tags of an experiment: its kind, a description, and a view of its results."""
    report = f"`python scripts/report.py experiment={name}` compares its cells."
    return {
        KIND: MODEL_TRAINING,
        VIEW: json.dumps({"name": "results", "createdAt": 0, "state": json.dumps({"selectedColumns": VIEW_COLUMNS})}),
        NOTE: f"Parking agents, trained and evaluated on highway-env's `parking-v0`: one run a cell and seed. {report}",
    }


def run_note(directory: RunDirectory, config: RunConfig) -> str:
    """Return the description of a run: what it is, how it went, its command line."""
    status, result = directory.read_status(), directory.result()
    how = str(status.get("status", "pending"))
    if result is not None:
        rates = {name: result.metrics.get(f"final/{name}_rate") for name in ("success", "crash", "parked")}
        words = ", ".join(f"{name} {rate:.1%}" for name, rate in rates.items() if rate is not None)
        scenes = f"{config.evaluation.final_n_scenes} scenes, {config.n_certified_scenes} of them cross-checked"
        how = f"{words} on {scenes} on highway-env, after {result.steps:,} env steps"
    lines = [f"{config.algorithm.name}, {config.buffer.name} on {config.env.name}, seed {config.seed}: {how}."]
    if command := status.get("command"):
        lines.append(f"Command: `{command}`")
    return "\n\n".join(lines)
