"""Training one run: loop, callbacks, checkpoints, exact resume."""
