"""`scripts/export.py` and `parking-export`: export a trained agent's policy."""

from parking_exp.cli.command import for_each, run_command
from parking_exp.evaluation.export_run import export_run, validate_request


def main() -> None:
    """Run the command."""
    run_command("export", for_each("export", validate_request, export_run))
