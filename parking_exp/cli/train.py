"""`scripts/train.py` and `parking-train`: train one run in this process, or a sweep."""

from parking_exp.cli.command import run_command
from parking_exp.config.compose import compose_runs
from parking_exp.config.rules import update_ratio_warning
from parking_exp.config.schema import SweepOptions
from parking_exp.config.validate import parse_config
from parking_exp.garbage_collection import no_garbage_collection
from parking_exp.terminal import say


def main() -> None:
    """Run the command."""
    run_command("config", train)


def train(overrides: list[str], extra_config_dir: str | None) -> None:
    """Train a single run in this process, several as a sweep."""
    with no_garbage_collection():
        from parking_exp.sweeps.launchers import make_launcher
        from parking_exp.sweeps.sweep import plan, sweep

        runs = compose_runs("config", overrides, extra_config_dir)
        cells = [run.cell for run in runs]
        first = cells[0].config  # all runs have the same keys of the sweep
        sweep_keys = {name: first[name] for name in SweepOptions.model_fields}
        options = parse_config(SweepOptions, sweep_keys)
        planned = plan(runs, options.retry)
        for warning in dict.fromkeys(update_ratio_warning(run.config) for run in planned):
            if warning is not None:
                say(f"warning: {warning}", stderr=True)
        names_launcher = any(
            override.lstrip("+~").startswith("hydra/launcher") for override in overrides
        )
        # Even a single run becomes a sweep for a launcher, a time limit, a dry run or a retry.
        is_elsewhere = names_launcher or cells[0].launcher != "local"
        has_limit = planned[0].config.timeout_s is not None
        needs_plan = options.dry_run or options.retry is not None
        is_sweep = len(planned) > 1 or is_elsewhere or has_limit or needs_plan

    if is_sweep:
        is_due = any(run.is_due for run in planned)
        launcher = make_launcher(cells, extra_config_dir, connect=is_due and not options.dry_run)
        sweep(planned, launcher, dry_run=options.dry_run)
    else:
        with no_garbage_collection(freeze=True):
            from parking_exp.sweeps import single_run

        single_run.train(planned[0].config)
