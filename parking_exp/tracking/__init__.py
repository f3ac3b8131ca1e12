"""The MLflow store: syncing run directories to it, and reading it in bulk."""
