"""The MLflow store: metrics, tags and artifacts of run directories, and reading them in bulk."""
