"""`scripts/benchmark.py` and `parking-benchmark`: measure speed as ratios."""

from parking_exp.benchmarks.run import benchmark, validate_benchmark
from parking_exp.cli.command import for_each, run_command


def main() -> None:
    """Run the command."""
    command = for_each("benchmark", validate_benchmark, benchmark)
    run_command("benchmark", command, flags={"--quick": "quick=true"})
