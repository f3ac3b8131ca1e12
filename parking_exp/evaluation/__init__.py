"""Find agents, evaluate them from fixed seeds, film and export them."""
