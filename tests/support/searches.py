"""Settings of searches, and the config that their trials change."""

import yaml

from parking_exp.config.compose import compose
from parking_exp.config.validate import parse_plain
from parking_exp.tuning.search import Search
from parking_exp.tuning.search_config import SearchConfig

SETTINGS = {
    "name": "test",
    "space": {"algorithm.gamma": {"uniform": [0.9, 0.99]}},
    "sampler": "tpe",
    "pruner": None,
    "tuning_seeds": [1001, 1002],
    "test_seeds": [2001, 2002],
    "n_retest": 1,
}
QUICK = (
    "search=smoke",
    "total_timesteps=60",
    "evaluation.final_n_scenes=3",
    "evaluation.every_n_steps=20",
    "tracking.tensorboard=false",
    "search.n_retest=0",
)


def settings(**changes):
    """A checked search."""
    return parse_plain(SearchConfig, SETTINGS | changes)


def base(tmp_path, *overrides):
    """The config that trials change."""
    options = ("experiment=smoke", "experiment_name=test", f"output_dir={tmp_path}")
    return compose(*options, *overrides)


def user_search(folder, overrides=(), **changes):
    """The search `mine` in a directory of the user's own."""
    (folder / "search").mkdir(parents=True)
    defaults = ["shared/defaults@search", "_self_", {"override /experiment": "smoke"}]
    search = {"name": "mine", "space": {"algorithm.gamma": {"uniform": [0.9, 0.99]}}, **changes}
    text = yaml.safe_dump({"defaults": defaults, "search": search})
    (folder / "search" / "mine.yaml").write_text(f"# @package _global_\n{text}")
    return Search(["search=mine", *overrides], str(folder))
