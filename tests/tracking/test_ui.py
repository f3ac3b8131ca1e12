"""What a newcomer sees in MLflow's UI at the address that `make ui` prints, in Chromium."""

import re
import shutil
import subprocess

import pytest
from support.mlflow_servers import closed_port, mlflow_server, needs_server
from support.runs import ROOT
from support.tracked_runs import finished_run

from parking_exp.tracking.mirror import mirror
from parking_exp.tracking.store import Store

playwright = pytest.importorskip("playwright.sync_api")
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"]


def make_ui(*arguments):
    """Lines that `make ui` would run or print."""
    command = ["make", "--dry-run", "ui", *arguments]
    return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout.splitlines()


def address_of(lines):
    return next(match[1] for line in lines if (match := re.search(r"(http://\S+machine_learning)", line)))


def test_make_ui_has_one_worker_and_prints_the_address_of_its_port():
    lines = make_ui()
    assert address_of(lines) == "http://127.0.0.1:5000/#/experiments?workflowType=machine_learning"
    assert "mlflow ui --workers 1 --backend-store-uri sqlite:///outputs/mlflow.db" in lines[-1]
    for arguments in ("ARGS=--port 7000", "ARGS=--host 0.0.0.0 -p 7000", "ARGS=--port=7000"):
        assert address_of(make_ui(arguments)).startswith("http://127.0.0.1:7000/#/")


@needs_server
@pytest.mark.skipif(BROWSER is None, reason="no browser found: apt-get install chromium")
def test_the_list_of_runs_shows_their_success_rates(tmp_path):
    with closed_port() as port:
        uri = f"http://127.0.0.1:{port}"
        directory = finished_run(tmp_path, uri=uri)
        directory.update(success_rate=0.985)
    with mlflow_server(port, tmp_path), playwright.sync_playwright() as driver:
        mirror(directory, Store(uri, tmp_path))
        browser = driver.chromium.launch(executable_path=BROWSER, args=ARGUMENTS)
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(address_of(make_ui(f"ARGS=--port {port}")), timeout=120_000)
        page.get_by_role("link", name="smoke").click(timeout=120_000)
        run = page.get_by_text(re.compile(r"^98\.5% parking-sac"))
        run.wait_for(timeout=120_000)
        assert run.is_visible()
        page.screenshot(path=tmp_path / "runs.png")
        browser.close()
