"""Tasks: the interface, parking with a vectorized simulator, Gymnasium's goal environments."""
