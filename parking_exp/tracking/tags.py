"""Tags of experiments and runs in MLflow: what identifies a run, its provenance, and descriptions for the UI."""

import json

from parking_exp.config.paths import database, relative_path
from parking_exp.config.schema import RunConfig
from parking_exp.runs.directory import RunDirectory, Status
from parking_exp.runs.run_provenance import PROVENANCE_FILE, read_provenance
from parking_exp.tasks.registry import METRICS

NOTE, KIND = "mlflow.note.content", "mlflow.experimentKind"
VIEW = "mlflow.sharedViewState.results"  # a saved view of the UI, whose own table of runs has no metric
RATES = [metric for metric in METRICS if metric.is_rate and metric.name != "timeout"]
VIEW_COLUMNS = [f"metrics.`final/{rate.key}`" for rate in RATES]
STARTED = "started_ms"
LONGEST_ERROR = 500


def experiment_tags(name: str) -> dict[str, str]:
    """Return MLflow's own tags of an experiment: its kind, a description, and a view of its results."""
    report = f"`python scripts/report.py experiment={name}` compares its cells."
    return {
        KIND: "custom_model_development",  # else the UI opens an experiment as one of GenAI: traces, prompts
        VIEW: json.dumps({"name": "results", "createdAt": 0, "state": json.dumps({"selectedColumns": VIEW_COLUMNS})}),
        NOTE: f"Goal-conditioned agents, trained and evaluated: one run per cell and seed. {report}",
    }


def run_tags(directory: RunDirectory, config: RunConfig, uri: str, status: Status) -> dict[str, str]:
    """Return the tags of a run; those that identify it overwrite others of the same name in its provenance."""
    path, entries = database(uri), directory.read_status()
    started_ms, provenance = read_provenance(directory.path / PROVENANCE_FILE)
    error = " ".join(str(entries.get("error", "")).split()) if status == "failed" else ""
    return {
        **provenance,
        **({STARTED: str(started_ms)} if started_ms is not None else {}),
        **{name: str(entries[name]) for name in ("search", "trial") if name in entries},
        "experiment": config.experiment_name,
        "cell": config.cell,
        "seed": str(config.seed),
        "run_key": config.run_key,
        "run_dir": relative_path(directory.path, path.parent) if path else str(directory.path.absolute()),
        "status": status,
        "error": error if len(error) <= LONGEST_ERROR else f"{error[: LONGEST_ERROR - 3]}...",
    }


def run_note(directory: RunDirectory, config: RunConfig) -> str:
    """Return the description of a run: what it is, its result or status, its command line."""
    status, result = directory.read_status(), directory.result()
    summary: str = directory.status
    if result is not None:
        rates = {rate.name: result.metrics.get(f"final/{rate.key}") for rate in RATES}
        percentages = ", ".join(f"{name} {rate:.1%}" for name, rate in rates.items() if rate is not None)
        checked = f", {config.n_certified} of them cross-checked on {config.env.simulators[-1]}"
        episodes = f"{config.evaluation.final_n_scenes} episodes{checked if len(config.env.simulators) > 1 else ''}"
        summary = f"{percentages} in {episodes}, after {result.steps:,} env steps"
    note = f"{config.algorithm.name}, {config.buffer.name} on {config.env.name}, seed {config.seed}: {summary}."
    command = status.get("command")
    return f"{note}\n\nCommand: `{command}`" if command else note
