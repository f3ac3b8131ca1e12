"""The end of a search: which trials are trained again, and the experiment file of the winner."""

import io

import yaml
from rich.console import Console
from support.searches import settings

from parking_exp.sweeps.hydra_launcher import Launch
from parking_exp.tuning import retest
from parking_exp.tuning.retest import RetestedTrial, tuned_config, write_winner
from parking_exp.tuning.run_search import tune
from parking_exp.tuning.search import Search
from parking_exp.tuning.trials import TrialRow


def trial(number, value, *runs, state="done"):
    values = [value] if state == "done" else []
    return TrialRow(number, state, {}, {}, values, [values], runs or [str(number)], 0, 0.0, None, 0.0)


def chosen(n_retest, *trials):
    return [one.number for one in retest._chosen(trials, settings(n_retest=n_retest))]


def test_trial_0_and_the_best_of_the_others_are_trained_again():
    trials = [trial(0, 0.1), trial(1, 0.9), trial(2, 0.0, state="pruned"), trial(3, 0.5), trial(4, 0.9)]
    assert chosen(2, *trials) == [0, 1, 4]
    assert chosen(9, *trials) == [0, 1, 4, 3]
    assert chosen(0, *trials) == []
    assert chosen(1, trial(0, 0.0, state="failed"), trial(1, 0.9)) == [1]


def test_of_trials_with_the_same_runs_the_first_is_trained_again():
    trials = [trial(0, 0.5, "a"), trial(1, 0.9, "b"), trial(2, 0.9, "c"), trial(3, 0.9, "b"), trial(4, 0.5, "a")]
    assert chosen(3, *trials) == [0, 1, 2]


def test_a_dry_run_promises_no_more_re_runs_than_there_are_trials(tmp_path, capsys):
    options = ["search=smoke", f"output_dir={tmp_path}", "search.test_seeds=[1,2,3]", "search.n_retest=4"]
    for n_trials, runs in ((2, 6), (20, 15)):
        tune(Search([*options, f"n_trials={n_trials}"]), Launch([]), dry_run=True)
        assert f"at the end {runs} runs on fresh seeds" in capsys.readouterr().out


def of_user(tmp_path):
    """A search and an algorithm in a directory of the user's own, whose name has a space."""
    folder = tmp_path / "my conf"
    (folder / "search").mkdir(parents=True)
    (folder / "algorithm").mkdir()
    (folder / "algorithm" / "mine.yaml").write_text("defaults:\n  - sac\n  - _self_\ntau: 0.03\n")
    content = {
        "defaults": ["shared/defaults@search", "_self_", {"override /experiment": "smoke"}],
        "search": {"name": "own", "space": {"algorithm.gamma": {"uniform": [0.9, 0.99]}}},
    }
    (folder / "search" / "own.yaml").write_text(f"# @package _global_\n{yaml.safe_dump(content)}")
    return Search(["search=own", "algorithm=mine", f"output_dir={tmp_path / 'out'}"], str(folder))


def test_the_winner_becomes_an_experiment_file_with_what_differs_from_the_groups_it_names(tmp_path):
    search, out = of_user(tmp_path), io.StringIO()
    winner = RetestedTrial(3, "trial 3: gamma=0.97", {"algorithm.gamma": 0.97}, [0.5, 0.7], [0.4, 0.6])
    search.folder.mkdir(parents=True)
    write_winner(search, [winner], Console(file=out, width=400))
    path = search.folder / "tuned_own.yaml"
    assert path.read_text().startswith("# @package _global_\n# Trial 3 of search own, the best of 1 on fresh seeds.\n")
    content = yaml.safe_load(path.read_text())
    assert content["defaults"] == [
        {"override /env": "parking"}, {"override /algorithm": "mine"}, {"override /buffer": "her_future"}
    ]  # fmt: skip
    assert content["experiment_name"] == "tuned_own"
    assert content["algorithm"]["gamma"] == 0.97
    assert "tau" not in content["algorithm"]
    assert "seed" not in content
    assert "video_episodes" not in content["evaluation"]
    assert tuned_config(path, search.extra_config_dir).algorithm.arguments["tau"] == 0.03
    assert out.getvalue().splitlines()[-1] == (
        f"train it with  python scripts/train.py experiment={path} --config-dir '{tmp_path}/my conf'"
    )
