"""The MLflow store: syncing run directories to it (metrics, tags, artifacts), and reading it in bulk."""
