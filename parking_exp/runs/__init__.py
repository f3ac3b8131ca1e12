"""Run directories: where a run lives, what is in it, and how far it is."""
