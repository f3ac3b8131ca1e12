"""Results of runs: from the MLflow store to tidy pandas frames; nothing here imports torch."""

from parking_exp.results.frames import Results, load

__all__ = ["Results", "load"]
