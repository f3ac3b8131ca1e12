"""The MLflow store: mirroring run directories to it (metrics, tags, artifacts), and reading it in
bulk.
"""
