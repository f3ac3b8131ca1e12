"""Rendering a report: HTML page, Markdown, LaTeX, CSV."""
