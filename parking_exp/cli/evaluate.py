"""`scripts/evaluate.py` and `parking-evaluate`: evaluate a trained agent."""

from parking_exp.cli.command import for_each, run_command
from parking_exp.evaluation.evaluate_run import evaluate_run, validate_request


def main() -> None:
    """Run the command."""
    run_command("evaluate", for_each("evaluate", validate_request, evaluate_run))
