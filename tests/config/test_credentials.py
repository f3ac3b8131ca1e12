"""Passwords of stores are used, and neither stored nor shown."""

import json

import pytest
from support.runs import call_script, make_config, only_run, run_script

from parking_exp.config.credentials import VARIABLE, keep_password, strip_password, with_password


@pytest.fixture(autouse=True)
def no_passwords(monkeypatch):
    monkeypatch.setenv(VARIABLE, "{}")


@pytest.mark.parametrize(("uri", "stripped"), [
    ("postgresql://me:secret@host/db", "postgresql://me@host/db"),
    ("postgresql+psycopg2://me:s@c/r:t@host:5432/db?sslmode=require", "postgresql+psycopg2://me@host:5432/db?sslmode=require"),
    ("postgresql://host/db?password=secret", "postgresql://host/db"),
    ("postgresql://host/db?user=me&password=secret&sslmode=require", "postgresql://host/db?user=me&sslmode=require"),
    ("https://me:secret@host/mlflow", "https://me@host/mlflow"),
    ("http://host:5000", "http://host:5000"),
    ("postgresql://host:5432/db?options=a", "postgresql://host:5432/db?options=a"),
    ("sqlite:////folder/mlflow.db", "sqlite:////folder/mlflow.db"),
    ("train.py 'tracking.uri=postgresql://me:secret@host/db' seed=1", "train.py 'tracking.uri=postgresql://me@host/db' seed=1"),
])  # fmt: skip
def test_a_uri_loses_its_password_and_keeps_its_user(uri, stripped):
    assert strip_password(uri) == stripped


def test_the_latest_password_of_a_uri_is_used():
    assert with_password("postgresql://me@host/db") == "postgresql://me@host/db"  # the driver looks for one
    for password in ("old", "new"):
        assert keep_password(f"postgresql://me:{password}@host/db") == "postgresql://me@host/db"
    assert with_password("postgresql://me@host/db") == "postgresql://me:new@host/db"
    assert with_password("postgresql://me@other/db") == "postgresql://me@other/db"


def test_a_config_has_no_password_and_does_not_depend_on_it():
    configs = [make_config(f"tracking.uri='postgresql://me:{password}@host/db'") for password in ("old", "se cret")]
    assert configs[0] == configs[1]
    assert configs[0].tracking.uri == "postgresql://me@host/db"
    assert with_password(configs[0].tracking.uri) == "postgresql://me:se cret@host/db"


def test_no_file_and_no_message_of_a_run_contains_the_password_of_its_store(tmp_path):
    uri = "http://me:se-cret@127.0.0.1:9/x"
    done = run_script("train", "experiment=smoke", "evaluation.video_episodes=0", f"tracking.uri={uri}", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    directory = only_run(tmp_path / "outputs")
    assert directory.tracking_uri == "http://me@127.0.0.1:9/x"
    assert "tracking.uri=http://me@127.0.0.1:9/x" in json.loads((directory.path / "status.json").read_text())["command"]
    files = [file for file in tmp_path.rglob("*") if file.is_file()]
    assert [file for file in files if b"se-cret" in file.read_bytes()] == []
    assert "se-cret" not in done.stdout + done.stderr


@pytest.mark.parametrize(
    "argument", ["tracking.uri=[postgresql://me:se-cret@host/db]", "seed=postgresql://me:se-cret@host/db"]
)
def test_an_error_message_does_not_contain_a_password(argument, tmp_path):
    done = call_script("train", argument, cwd=tmp_path)
    assert done.returncode == 2
    assert "cret" not in done.stderr
