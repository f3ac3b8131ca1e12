"""README and the pages of docs/: links and paths exist, commands and examples run."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support.marks import slow_but
from support.runs import ROOT, call_script
from support.store_factory import make_store

from parking_exp import compose, train

PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "CHANGELOG.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
EXTENDING = ROOT / "docs" / "extending.md"
LARGE = re.compile(
    r"train\.py.* experiment=(her|algorithms|variants|goal_tasks)|tune\.py search=recipe (?!.*dry_run)"
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


def add(path, text):
    """Write a block to a new file, or insert it into an existing one after its first line."""
    path.parent.mkdir(parents=True, exist_ok=True)
    line = text[: text.index("\n") + 1]
    old = path.read_text() if path.exists() else line
    assert line in old
    path.write_text(old.replace(line, text))


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
    # The commands of extending.md need the files of its examples; benchmarks take minutes.
    every = [
        command
        for command in commands(*(set(PAGES) - {EXTENDING}))
        if not command.startswith("benchmark.py")
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
        done = call_script(script.removesuffix(".py"), *words, cwd=tmp_path)
        assert done.returncode == 0, (command, done.stderr)


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
    ((title, text),) = blocks(ROOT / "docs" / "tuning.md", "yaml")
    add(tmp_path / title, text)
    done = call_script(
        "tune", "--config-dir", "my_conf", "search=mine", "dry_run=true", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert "buffer.n_sampled_goal" in done.stdout


def test_the_task_of_the_extending_page_is_learned(output_dir, tmp_path, monkeypatch):
    for title, text in blocks(EXTENDING, "python") + blocks(EXTENDING, "yaml"):
        if "reach" in title:
            add(tmp_path / title, text)
    monkeypatch.syspath_prepend(tmp_path)
    few = ("n_envs=4", "algorithm.learning_starts=500", "algorithm.net_arch=[32,32]")
    overrides = ("env=reach", "total_timesteps=3000", *few, f"output_dir={output_dir}")
    config = compose(*overrides, "tracking.mlflow=false", config_dir=tmp_path / "my_conf")
    metrics = train(config).metrics
    assert metrics["final/success_rate"] >= 0.9  # of a policy that stands still: 0.01
    assert -1 <= metrics["final/end_x_mean"] <= 1


@pytest.mark.slow
def test_the_examples_of_the_extending_page_run_and_appear_in_results(tmp_path):
    for folder in ("parking_exp", "conf", "scripts"):
        shutil.copytree(
            ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__")
        )
    for title, text in blocks(EXTENDING, "python") + blocks(EXTENDING, "yaml"):
        add(tmp_path / title, text)
    # One command trains a run with all extensions, one shortly on another task; the others print
    # their plan.
    short = [
        "total_timesteps=1000",
        "evaluation.n_scenes=5",
        "evaluation.final_n_scenes=5",
        "experiment_name=other",
    ]
    for command in commands(EXTENDING):
        added = (
            short
            if "my_tasks" in command
            else []
            if "env=reach" in command
            else []
            if "mine" in command
            else ["dry_run=true"]
        )
        words = [sys.executable, *shlex.split(f"scripts/{command}"), *added]
        subprocess.run(
            words,
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(tmp_path)},
            check=True,
            timeout=300,
        )
    (result,) = tmp_path.glob(
        "outputs/mine/parking_dense_lot-fading_sac-her_late-*/seed=0/result.json"
    )
    assert "final/centred_rate" in result.read_text()
    (other,) = tmp_path.glob("outputs/other/*/seed=0/result.json")
    assert 0 <= json.loads(other.read_text())["metrics"]["final/failure_rate"] <= 1
    assert "How many seeds" in (tmp_path / "outputs/reports/mine/index.html").read_text()
