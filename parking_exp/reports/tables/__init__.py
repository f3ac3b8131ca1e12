"""Tables of a report: the table model, and the content of each table."""
