"""MLflow's UI: the command that starts it, and where it shows each experiment.

`python -m parking_exp.tracking.ui_addresses STORE PORT` prints these addresses, since the UI's own
links lead to its GenAI view, which shows no runs.
"""

import shlex
import sys
from pathlib import Path

from parking_exp.config.paths import database_file, default_uri
from parking_exp.terminal import is_script, say
from parking_exp.tracking.store import Store


def ui_command(uri: str) -> str:
    """Return the command that shows a store in MLflow's UI; a tracking server is its own."""
    if not uri.startswith("sqlite"):
        return uri
    if not is_script():
        return f"mlflow ui --workers 1 --backend-store-uri {shlex.quote(uri)}"
    if uri == default_uri(Path("outputs").absolute()):
        return "make ui"
    return f"make ui STORE={shlex.quote(uri)}"


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
