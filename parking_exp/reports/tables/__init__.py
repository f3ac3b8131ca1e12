"""Tables of a report: the model, the tables, and generic writers for Markdown, LaTeX and CSV."""
