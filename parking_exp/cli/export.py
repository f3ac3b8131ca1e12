"""`scripts/export.py` and `parking-export`: export a trained agent's policy."""

from parking_exp.cli.command import run_command
from parking_exp.config.compose import compose_configs
from parking_exp.evaluation.export_run import export_runs


def main() -> None:
    """Run the command."""
    run_command("export", export)


def export(overrides: list[str], extra_config_dir: str | None) -> None:
    """Export the agents of every config that the overrides define."""
    export_runs(compose_configs("export", overrides, extra_config_dir))
