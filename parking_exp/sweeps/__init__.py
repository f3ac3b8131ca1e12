"""Sweeps of many runs: plan, launchers, worker processes, live view."""
