"""Tasks: the interface, parking-v0 with its vectorized simulator, and any goal environment of
Gymnasium.
"""
