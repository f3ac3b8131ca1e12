"""Provenance of a run: versions of packages, git commit, CPU, and the command line that was typed."""

import platform
import shlex
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from parking_exp import __version__
from parking_exp.config.credentials import strip_password
from parking_exp.runs.atomic_files import read_object

PROVENANCE_FILE = "provenance.json"
TAGS = {"git_commit", "git_dirty", "cpu"}  # and version.PACKAGE
PACKAGES = ["torch", "stable-baselines3", "highway-env", "gymnasium", "numpy", "hydra-core", "mlflow-skinny"]


def provenance() -> dict[str, str]:
    """Return tags: `version.<package>`, `git_commit`, `git_dirty`, `cpu`. What can't be known is left out."""
    tags = {"version.python": platform.python_version(), "version.parking-exp": __version__}
    for package in PACKAGES:
        try:
            tags[f"version.{package}"] = version(package)
        except PackageNotFoundError:
            continue
    return tags | _git() | {"cpu": _cpu()}


def typed_command() -> str | None:
    """Return the command line of this process where it is one of ours, without passwords."""
    name = Path(sys.argv[0]).name
    if name.startswith("parking-"):
        words = [name]
    elif name in {"train.py", "tune.py"}:
        words = ["python", f"scripts/{name}"]
    else:  # called from Python
        return None
    return shlex.join([*words, *map(strip_password, sys.argv[1:])])


def read_provenance(path: Path) -> tuple[int | None, dict[str, str]]:
    """Return when a run was started, in ms since 1970, and its tags; other tags are left out."""
    found = read_object(path)
    started_ms, tags = found.get("started_ms"), found.get("tags")
    known = {
        name: value
        for name, value in (tags.items() if isinstance(tags, dict) else ())
        if isinstance(value, str) and (name in TAGS or name.startswith("version."))
    }
    return started_ms if type(started_ms) is int and 0 <= started_ms < 2**53 else None, known


def _git() -> dict[str, str]:
    """Commit of this package's checkout, and whether tracked files differ from it."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return {}
    commit = _run_git(root, "rev-parse", "HEAD")
    if commit is None:
        return {}
    changes = _run_git(root, "status", "--porcelain", "--untracked-files=no")
    return {"git_commit": commit, "git_dirty": str(bool(changes)).lower()}


def _run_git(root: Path, *arguments: str) -> str | None:
    try:
        command = ["git", "-C", str(root), *arguments]
        done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=10)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
