"""Command lines: what is typed becomes one call, errors become sentences."""
