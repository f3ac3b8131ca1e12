"""Tables of a report: their model, what each of them says, and writers that know none of them."""
