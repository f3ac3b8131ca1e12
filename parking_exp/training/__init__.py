"""Training one run: its session, callbacks, checkpoints, exact resume."""
