"""README and the pages of docs/: links and paths exist, commands and examples run."""

import json
import os
import re
import shlex
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pandas as pd
import pytest
from support.marks import slow_but
from support.runs import ROOT, call_script
from support.store_factory import make_store

from parking_exp import compose, train
from parking_exp.runs.metric_logs import read_metrics

PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "CHANGELOG.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
EXTENDING = ROOT / "docs" / "extending.md"
LARGE = re.compile(
    r"train\.py.* experiment=(her|algorithms|variants|goal_tasks)"
    r"|tune\.py search=recipe (?!.*dry_run)"
)
FENCE = re.compile(r"^```(\w*)(?: title=\"([^\"]+)\")?\n(.*?)^```", re.MULTILINE | re.DOTALL)


def blocks(page, language):
    """Return the fenced blocks of a page: (title, text)."""
    return [
        (title, text) for name, title, text in FENCE.findall(page.read_text()) if name == language
    ]


def commands(*pages):
    """Return the commands of pages that run one of our scripts, without the prefix `python
    scripts/`.
    """
    texts = [text for page in pages for _, text in blocks(page, "sh")]
    texts += [
        line
        for page in pages
        for line in re.findall(r"^`(python .*)`$", page.read_text(), re.MULTILINE)
    ]
    lines = [line for text in texts for line in text.replace("\\\n", "").split("\n")]
    matches = (match[1] for line in lines if (match := re.search(r"python scripts/(.*)", line)))
    return list(
        dict.fromkeys(shlex.join(shlex.split(command, comments=True)) for command in matches)
    )


def cheap(command):
    """Return a command's words: a training prints its plan, the other commands print their
    config.
    """
    words = shlex.split(command)
    added = ["dry_run=true"] if words[0] in ("train.py", "tune.py") else ["--cfg", "job"]
    return words if "--cfg" in words else words + [word for word in added if word not in words]


def write_examples(page, folder, *languages):
    """Write the titled blocks of a page to files below a folder."""
    for language in languages:
        for title, text in blocks(page, language):
            if title:
                path = folder / title
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text)


def anchors(page):
    headings = re.findall(r"^#+ (.+)$", FENCE.sub("", page.read_text()), re.MULTILINE)
    return {
        re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings
    }


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_their_anchors_and_named_files_exist(page):
    text = FENCE.sub("", page.read_text())
    for target in re.findall(r"\]\((?!http)([^)\s]+)\)", text):
        path, _, anchor = target.partition("#")
        linked = page.parent / path if path else page
        assert linked.exists() and (not anchor or anchor in anchors(linked)), target
    for path in re.findall(r"`((?:conf|docs|parking_exp|scripts|tests)/[\w/.]+)`", text):
        assert "NAME" in path or (ROOT / path).exists(), path


def test_the_reference_has_every_package():
    packages = {path.parent.name for path in (ROOT / "parking_exp").glob("*/__init__.py")}
    named = re.findall(
        r"^::: parking_exp\.(\w+)$", (ROOT / "docs" / "api.md").read_text(), re.MULTILINE
    )
    assert sorted(named) == sorted(packages - {"cli"})


@pytest.mark.usefixtures("srun")
@pytest.mark.parametrize("first", slow_but([True], [True, False]))
def test_commands_run(first, tmp_path):
    """Those of the pages that a new user reads first, and of all others."""
    winner = tmp_path / "outputs" / "recipe" / "tuned_recipe.yaml"  # as a search writes it
    winner.parent.mkdir(parents=True)
    winner.write_text("# @package _global_\nexperiment_name: tuned\n")
    # The commands of extending.md need the files of its examples; the two scripts take minutes.
    every = [
        command
        for command in commands(*(set(PAGES) - {EXTENDING}))
        if not command.startswith(("benchmark.py", "robustness.py"))
        and "init=latest" not in command
    ]
    read_first = commands(ROOT / "README.md", ROOT / "docs" / "getting_started.md")
    selected = [
        command
        for command in every
        if (command in read_first and not LARGE.match(command)) == first
    ]
    assert len(selected) > 5
    for command in selected:
        script, *words = cheap(command)
        call_script(script.removesuffix(".py"), *words, cwd=tmp_path, code=0)


@pytest.mark.slow
def test_runs_start_from_other_agents_as_their_page_shows(tmp_path):
    """With few env steps and envs; pretrained weights, a longer training, a curriculum."""
    few = (
        "total_timesteps=2500",
        "n_envs=4",
        "evaluation.n_scenes=2",
        "evaluation.final_n_scenes=2",
        "evaluation.video_episodes=0",
        "tracking.mlflow=false",
    )
    single_runs = []
    for command in commands(ROOT / "docs" / "starting.md"):
        if command.startswith("train.py") and "seeds=10" not in command:
            single_runs.append(command)
    assert sum("init=" in command for command in single_runs) == 3
    for command in single_runs:
        _, *words = shlex.split(command)
        if "algorithm.learning_starts=0" not in words:
            words.append("algorithm.learning_starts=2004")
        call_script("train", *words, *few, cwd=tmp_path, code=0)


EXAMPLES = [page for page in PAGES if any(not title for title, _ in blocks(page, "python"))]
FAST = [page for page in EXAMPLES if page.stem in ("environment", "exporting")]


@pytest.mark.parametrize("page", slow_but(FAST, EXAMPLES), ids=lambda page: page.stem)
def test_python_examples_run(page, output_dir, tmp_path, monkeypatch):
    if "load(" in page.read_text():
        make_store(
            output_dir, "her_ablation", {"four": ["buffer.n_sampled_goal=4"]}, seeds=range(1)
        )
    monkeypatch.chdir(tmp_path)
    Path("outputs").symlink_to(output_dir)
    examples = [text for title, text in blocks(page, "python") if not title]
    assert examples
    for text in examples:
        exec(compile(text, str(page), "exec"), {})  # raises where an example is wrong


def test_the_search_of_the_tuning_page_is_valid(tmp_path):
    write_examples(ROOT / "docs" / "tuning.md", tmp_path, "yaml")
    done = call_script(
        "tune", "--config-dir", "my_conf", "search=mine", "dry_run=true", cwd=tmp_path, code=0
    )
    assert "buffer.n_sampled_goal" in done.stdout


def test_the_task_of_the_extending_page_is_learned(output_dir, tmp_path, monkeypatch):
    write_examples(EXTENDING, tmp_path, "python", "yaml")
    monkeypatch.syspath_prepend(tmp_path)
    few = ("n_envs=4", "algorithm.learning_starts=500", "algorithm.net_arch=[32,32]")
    overrides = ("env=reach", "total_timesteps=3000", *few, f"output_dir={output_dir}")
    config = compose(*overrides, "tracking.mlflow=false", config_dir=tmp_path / "my_conf")
    metrics = train(config).metrics
    assert metrics["final/success_rate"] >= 0.9  # of a policy that stands still: 0.01
    assert -1 <= metrics["final/end_x_mean"] <= 1


def test_the_policy_of_the_extending_page_succeeds_without_training(
    output_dir, tmp_path, monkeypatch
):
    write_examples(EXTENDING, tmp_path, "python", "yaml")
    monkeypatch.syspath_prepend(tmp_path)
    overrides = ("env=reach", "algorithm=straight", f"output_dir={output_dir}")
    config = compose(*overrides, "tracking.mlflow=false", config_dir=tmp_path / "my_conf")
    result = train(config)
    assert result.metrics["final/success_rate"] == 1


def test_the_tracker_of_the_extending_page_has_each_value(output_dir, tmp_path, monkeypatch):
    write_examples(EXTENDING, tmp_path, "python")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    overrides = ("experiment=smoke", "total_timesteps=200", f"output_dir={output_dir}")
    tracker = "tracking.trackers=[my_trackers.DatabaseTracker]"
    result = train(compose(*overrides, "tracking.mlflow=false", tracker))

    with closing(sqlite3.connect("metrics.db")) as database:
        rows = database.execute("SELECT run, step, name, value FROM metrics").fetchall()
    expected = []
    for record in read_metrics(Path(result.run_dir) / "metrics.jsonl"):
        for name, value in record["metrics"].items():
            expected.append((result.run_dir, record["step"], name, value))
    assert len(expected) > 20
    assert rows == expected


SHORT = [
    "total_timesteps=1000",
    "evaluation.n_scenes=5",
    "evaluation.final_n_scenes=5",
    "experiment_name=other",
    "hydra/launcher=local",  # which Hydra has to find in the wheel
]
TRAIN = """
import sys
import parking_exp
from parking_exp import compose, load_model, train

train(compose(*sys.argv[1:], config_dir="my_conf"))
features = ["algorithm=sac_difference", "experiment=smoke", "total_timesteps=60"]
result = train(compose(*features, config_dir="my_conf"))
print(parking_exp.__file__)
print(type(load_model(result.run_dir).actor.features_extractor))
"""


@pytest.fixture
def user(installed_wheel, tmp_path):
    """The options of processes in a folder with the examples and nothing else of the repository."""
    write_examples(EXTENDING, tmp_path, "python", "yaml")
    environment = {**os.environ, "PYTHONPATH": f"{installed_wheel}:{tmp_path}"}
    return {"cwd": tmp_path, "env": environment, "timeout": 300}


def test_the_examples_of_the_extending_page_train_from_python(user, installed_wheel, tmp_path):
    (together,) = [command for command in commands(EXTENDING) if "experiment_name=mine" in command]
    overrides = [word for word in shlex.split(together) if "=" in word]
    overrides += ["evaluation.video_episodes=0", "tracking.mlflow=false"]
    program = [sys.executable, "-c", TRAIN, *overrides]
    done = subprocess.run(program, check=True, capture_output=True, text=True, **user)

    *_, package, features = done.stdout.splitlines()
    assert package == f"{installed_wheel}/parking_exp/__init__.py"
    assert features == "<class 'my_networks.GoalDifference'>"
    (directory,) = tmp_path.glob("outputs/mine/parking_dense_lot-fading_sac-her_late-*/seed=0")
    episodes = pd.read_csv(directory / "episodes.csv")
    final = episodes[episodes["phase"] == "final"]
    metrics = json.loads((directory / "result.json").read_text())["metrics"]
    assert metrics["final/centred_rate"] == (final["distance_m"] < 0.5).mean()


@pytest.mark.slow
def test_the_commands_of_the_extending_page_run_with_an_installed_wheel(
    user, installed_wheel, tmp_path
):
    # One command trains a run with all extensions, one shortly on another task, and one evaluates;
    # the others print their plan.
    for command in commands(EXTENDING):
        script, *words = shlex.split(command)
        name = script.removesuffix(".py")
        if "my_tasks" in command:
            words += SHORT
        elif name == "train" and "mine" not in command and "env=reach" not in command:
            words.append("dry_run=true")
        program = [sys.executable, installed_wheel / "bin" / f"parking-{name}", *words]
        subprocess.run(program, check=True, **user)

    (other,) = tmp_path.glob("outputs/other/*/seed=0/result.json")
    assert 0 <= json.loads(other.read_text())["metrics"]["final/failure_rate"] <= 1
    (evaluation,) = tmp_path.glob("outputs/pretrained/default/evaluations/*")
    distance = pd.read_csv(evaluation / "episodes.csv")["distance_m"]
    summary = json.loads((evaluation / "summary.json").read_text())
    assert summary["centred_rate"] == (distance < 0.5).mean()
    page = (tmp_path / "outputs/reports/mine/index.html").read_text()
    assert "How many seeds" in page
    assert '<table id="table-replicates">' in page
    assert "centred (%)" in page
