"""URIs of stores: those that may contain a secret are refused, whatever its form."""

import pytest
from support.runs import call_script, refusal

from parking_exp.config.paths import refuse_password
from parking_exp.errors import ConfigError


@pytest.mark.parametrize(
    "uri",
    [
        "postgresql://me:s3cret@host/db",
        "postgresql://me:5432/s3cret@host",
        "postgresql://me@s3cret@host/db",
        "postgresql://me%3As3cret@host/db",
        "postgresql://me@host/db?password=s3cret",
        "postgresql://me@host/db?PASSWORD=s3cret",
        "postgresql://me@host/db?pass%77ord=s3cret",
        "postgresql://me@host/db?sslmode=require&pwd=s3cret",
        "mysql+pymysql://me@host/db?passwd=s3cret",
        "mssql+pyodbc:///?odbc_connect=DRIVER%3Dx%3BPWD%3Ds3cret",
        "mssql+pyodbc://me@host/db?driver=x%3BPWD%3Ds3cret",
        "mssql+pyodbc://dsn;PWD=s3cret",
        "http://me:s3cret@host:5000",
        "https://s3cret@host",
        "http://host:5000?token=s3cret",
        "http://host:5000/?s3cret",
        "http://host/#access_token=s3cret",
        "databricks://token:s3cret@host",
    ],
)
def test_a_uri_that_may_contain_a_secret_is_refused_without_showing_it(uri):
    with pytest.raises(ConfigError, match="set it in the environment") as refusal:
        refuse_password(uri)
    assert "s3cret" not in str(refusal.value)


def test_a_command_with_a_secret_in_its_uri_is_refused_before_anything_is_written(tmp_path):
    uri = "postgresql://me:s3cret@host/db"
    options = (f"tracking.uri='{uri}'", f"output_dir={tmp_path / 'outputs'}")
    sentence = refusal("train", "experiment=smoke", *options)
    assert sentence.startswith("tracking.uri: the URI contains ")
    assert "s3cret" not in sentence
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "uri",
    [
        "sqlite:////tmp/a@b:c#d/mlflow.db",
        "http://host:5000",
        "https://[::1]:5000/prefix",
        "postgresql://host:5432/db",
        "postgresql+psycopg2://me@host:5432/db?sslmode=require&connect_timeout=5",
        "postgresql:///db?host=/var/run/postgresql",
        "mysql+pymysql://me@host/db?read_default_file=~/.my.cnf",
        "mssql+pyodbc://me@host/db?driver=ODBC+Driver+18+for+SQL+Server&TrustServerCertificate=yes",
        "databricks",
        "databricks://profile:prefix",
    ],
)
def test_a_uri_without_a_secret_is_accepted(uri):
    assert refuse_password(uri) == uri


@pytest.mark.parametrize("argument", ["output_dir=outputs", "tracking.uri=sqlite:///store.db"])
def test_a_path_with_a_question_mark_is_refused_before_anything_is_written(tmp_path, argument):
    folder = tmp_path / "que?ue"
    folder.mkdir()
    reason = "has a question mark, at which the URI of a sqlite store ends; choose another path"
    assert reason in call_script("train", "experiment=smoke", argument, cwd=folder, code=2).stderr
    assert [path.name for path in tmp_path.rglob("*")] == ["que?ue"]
