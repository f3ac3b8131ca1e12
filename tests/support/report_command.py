"""`scripts/report.py` in this process: a process of its own would import for seconds."""

from support.runs import call_script


def report(output_dir, *arguments, code=0):
    """Run the command in an output directory, and return what it printed."""
    return call_script("report", *arguments, f"output_dir={output_dir}", cwd=output_dir, code=code)
