"""MLflow's UI as a newcomer sees it at the address that `make ui` prints, in Chromium."""

import re
import subprocess
import sys

from support.mlflow_servers import closed_port, mlflow_server, needs_server
from support.runs import ROOT
from support.sync_processes import sync
from support.tracked_runs import finished_run

from parking_exp.config.paths import default_uri


def lines_of(*command):
    done = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
    return done.stdout.splitlines()


def make_ui(*arguments):
    """Commands that `make ui` would run."""
    return lines_of("make", "--no-print-directory", "--dry-run", "ui", *arguments)


def addresses(uri, port):
    """Address of each experiment, as `make ui` prints them."""
    lines = lines_of(sys.executable, "-m", "parking_exp.tracking.ui_addresses", uri, str(port))
    return dict(line.split() for line in lines)


def test_make_ui_has_one_worker_and_prints_addresses_with_its_port():
    for arguments, port in {
        "": 5000,
        "--port 7000": 7000,
        "--host 0.0.0.0 -p 7000": 7000,
        "--port=7000": 7000,
    }.items():
        *_, printing, serving = make_ui(f"ARGS={arguments}")
        assert printing.endswith(
            f"-m parking_exp.tracking.ui_addresses sqlite:///outputs/mlflow.db {port}"
        )
        assert "mlflow ui --workers 1 --backend-store-uri sqlite:///outputs/mlflow.db" in serving


def test_the_address_of_an_experiment_leads_to_its_runs(output_dir):
    sync(finished_run(output_dir))
    page = "http://127.0.0.1:5000/#/experiments/1/runs?workflowType=machine_learning"
    assert addresses(default_uri(output_dir), 5000) == {"smoke": page}


@needs_server
def test_the_list_of_runs_shows_their_success_rates(browser, tmp_path):
    with closed_port() as port:
        uri = f"http://127.0.0.1:{port}"
        directory = finished_run(tmp_path, uri=uri)
        directory.update_status(success_rate=0.985)
    with mlflow_server(port, tmp_path):
        sync(directory)
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(addresses(uri, port)["smoke"], timeout=120_000)
        run = page.get_by_text(re.compile(r"^98\.5% parking-sac"))
        run.wait_for(timeout=120_000)
        assert run.is_visible()
        page.screenshot(path=tmp_path / "runs.png")
        page.close()
