"""Experiment files from anywhere, `experiment=PATH.yaml`."""

import pytest
from support.runs import make_config

from parking_exp.config.overrides import in_quotes, with_absolute_path
from parking_exp.errors import ConfigError


def test_an_experiment_file_may_have_quotes_in_its_path(tmp_path):
    path = tmp_path / 'it\'s "mine"' / "own.yaml"
    path.parent.mkdir()
    path.write_text("# @package _global_\ntotal_timesteps: 30000\n")
    line = f"experiment={in_quotes(str(path))}"
    assert with_absolute_path(line) == line
    assert make_config(line).total_timesteps == 30_000


def test_a_yaml_file_that_cannot_be_read_gets_a_sentence(tmp_path):
    (tmp_path / "broken.yaml").write_text("a: [1,")
    with pytest.raises(ConfigError, match="a YAML file can't be read"):
        make_config(f"experiment={tmp_path / 'broken.yaml'}")
