"""parking-v0 and its variants: highway-env's own, and a vectorized simulator that gives the same
episodes.
"""
