"""The files of a report: HTML page, Markdown, tables and figures on disk."""
