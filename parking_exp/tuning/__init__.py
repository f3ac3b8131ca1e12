"""Hyperparameter searches: Optuna over composed configs, trained by the launchers and supervisors
of sweeps.
"""
