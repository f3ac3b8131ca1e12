"""Hyperparameter searches: Optuna over composed configs, trained as sweeps train their runs."""
