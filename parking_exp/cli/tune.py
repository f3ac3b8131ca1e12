"""`scripts/tune.py` and `parking-tune`: search hyperparameters."""

from parking_exp.cli.command import run_command


def main() -> None:
    """Run the command."""
    run_command("tune", tune)


def tune(overrides: list[str], extra_config_dir: str | None) -> None:
    """Run a search."""
    from parking_exp.sweeps.launchers import make_launcher
    from parking_exp.tuning.run_search import run_search
    from parking_exp.tuning.search import Search

    search = Search(overrides, extra_config_dir)
    run_search(search, make_launcher([search.compose({})], extra_config_dir))
