"""Tasks: the interface, parking-v0 with a vectorized simulator, Gymnasium's goal environments."""
