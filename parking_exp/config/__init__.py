"""The schema of a run's config, how it is composed and checked; nothing here imports torch."""
