"""The end of a search: which trials are trained again, and the experiment file of the winner."""

import io
import shlex

import yaml
from rich.console import Console
from support.searches import user_search

from parking_exp.config.compose import composed_runs
from parking_exp.config.overrides import in_quotes
from parking_exp.config.validate import validate
from parking_exp.tuning.run_search import chosen_trials, write_winner
from parking_exp.tuning.trials import RetestedTrial, TrialRow


def trial(number, value, *runs, state="done"):
    done = state == "done"
    return TrialRow(number, state, value=value if done else None, by_seed=[value] * done, runs=runs or [str(number)])


def chosen(n_retest, *trials):
    return [trial.number for trial in chosen_trials(trials, n_retest)]


def test_trial_0_and_the_best_of_the_others_are_trained_again():
    trials = [trial(0, 0.1), trial(1, 0.9), trial(2, 0.0, state="pruned"), trial(3, 0.5), trial(4, 0.9)]
    assert chosen(2, *trials) == [0, 1, 4]
    assert chosen(9, *trials) == [0, 1, 4, 3]
    assert chosen(1, trial(0, 0.0, state="failed"), trial(1, 0.9)) == [1]
    same = [trial(0, 0.5, "a"), trial(1, 0.9, "b"), trial(2, 0.9, "c"), trial(3, 0.9, "b"), trial(4, 0.5, "a")]
    assert chosen(3, *same) == [0, 1, 2]  # the first of the trials with the same runs


def test_the_winner_becomes_an_experiment_file_that_composes_to_its_config(tmp_path):
    """Also with options of a user's directory, whose name has a space."""
    folder, out = tmp_path / "my conf", io.StringIO()
    (folder / "algorithm").mkdir(parents=True)
    (folder / "algorithm" / "mine.yaml").write_text("defaults:\n  - sac\n  - _self_\ntau: 0.03\n")
    search = user_search(folder, ["algorithm=mine", f"output_dir={tmp_path / 'out'}"])
    search.folder.mkdir(parents=True)
    winner = RetestedTrial(3, "trial 3: gamma=0.97", {"algorithm.gamma": 0.97}, [0.5, 0.7], [0.4, 0.6])
    write_winner(search, [winner], Console(file=out, width=400))
    path = search.folder / "tuned_mine.yaml"
    content = yaml.safe_load(path.read_text())
    assert content["defaults"][1] == {"override /algorithm": "mine"}
    assert content["experiment_name"] == "tuned_mine"
    (run,) = composed_runs("config", [f"experiment={in_quotes(str(path))}"], str(folder))
    assert validate(run.cell).cell_key == search.config({"algorithm.gamma": 0.97}).cell_key
    assert shlex.split(out.getvalue().splitlines()[-1])[-3:] == [f"experiment={path}", "--config-dir", str(folder)]
