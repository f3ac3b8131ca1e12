"""Command-line entry points: parse, make one call, report errors as sentences."""
