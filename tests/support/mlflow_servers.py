"""MLflow servers for tests, and ports where none listens."""

import importlib.util
import os
import socket
import subprocess
import sys
from contextlib import contextmanager

import pytest

from support.sweep_processes import wait_until


def needs_server(test):
    """Mark a test that needs the full mlflow; `make test-server` runs these alone."""
    skipped = pytest.mark.skipif(
        importlib.util.find_spec("flask") is None,
        reason="`mlflow server` needs the full mlflow: pip install 'parking-exp[ui]'",
    )
    return pytest.mark.server(skipped(test))


@contextmanager
def closed_port():
    """A port where nobody listens, kept from others."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        yield listener.getsockname()[1]


@contextmanager
def mlflow_server(port, folder):
    """A server with its database and artifacts in a folder."""
    command = [sys.executable, "-m", "mlflow", "server", "--port", str(port), "--workers", "1",
               "--backend-store-uri", f"sqlite:///{folder}/server.db",
               "--artifacts-destination", str(folder / "kept")]  # fmt: skip
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        wait_until(lambda: _listens(port), timeout=120)
        yield f"http://127.0.0.1:{port}"
    finally:
        os.killpg(process.pid, 15)
        process.wait(timeout=30)


def _listens(port):
    with socket.socket() as client:
        return client.connect_ex(("127.0.0.1", port)) == 0
