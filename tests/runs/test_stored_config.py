"""Stored configs are read back as they were, or refused with the key that is wrong."""

import pytest

from parking_exp.config.compose import compose
from parking_exp.errors import ConfigError
from parking_exp.runs.directory import RunDirectory


@pytest.fixture
def directory(tmp_path):
    config = compose("experiment=smoke", f"output_dir={tmp_path}")
    directory = RunDirectory(config.run_dir)
    directory.write_config(config)
    return directory


def test_a_stored_config_is_read_back_as_it_was(directory, tmp_path):
    assert directory.read_config() == compose("experiment=smoke", f"output_dir={tmp_path}")


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("n_envs:", "number_of_envs:", "number_of_envs"),
        ("name: sac", "name: a ${oc.env:HOME}", "a ${oc.env:HOME}"),
    ],
)
def test_a_stored_config_that_does_not_fit_the_schema_is_refused(directory, old, new, named):
    path = directory.path / "config.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ConfigError, match=r"config\.yaml") as refused:
        directory.read_config()
    assert named in str(refused.value)


@pytest.mark.parametrize(
    "content",
    [b"", b"a: [", b"a: !!python/object/apply:os.system [ls]", b"\xff", b"a: &a [1]\nb: [*a, *a]"],
)
def test_a_stored_config_that_is_damaged_is_refused_in_one_sentence(directory, content):
    path = directory.path / "config.yaml"
    path.write_bytes(content)
    with pytest.raises(ConfigError) as refused:
        directory.read_config()
    assert str(refused.value).startswith(f"{path} can't be read: ")
    assert "\n" not in str(refused.value)
