"""parking-v0 and its variants: highway-env's, and a vectorized simulator of the same episodes."""
