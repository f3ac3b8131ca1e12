"""Run directories: layout, locks, stored config, logs, provenance, and the state of a run."""
