"""Print where MLflow's UI shows each experiment: `python -m parking_exp.tracking.ui_addresses STORE
PORT`.

The UI's own links lead to its GenAI view, which shows no runs.
"""

import sys

from parking_exp.config.paths import database_file
from parking_exp.terminal import say
from parking_exp.tracking.store import Store


def main() -> None:
    """Print one line for each experiment that has been made."""
    uri, port = sys.argv[1:]
    store = Store(uri, None)
    path = database_file(store.uri)
    if path is not None and not path.exists():
        say(f"there is no store {path} yet; train something first")
        return
    for name, experiment_id in sorted(store.experiment_ids().items(), key=lambda item: item[1]):
        if name != "Default":  # MLflow makes it; it stays empty
            address = f"http://127.0.0.1:{port}/#/experiments/{experiment_id}/runs?workflowType=machine_learning"
            say(f"{name:<20} {address}")


if __name__ == "__main__":
    main()
