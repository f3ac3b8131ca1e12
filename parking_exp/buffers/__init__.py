"""Replay buffer with Hindsight Experience Replay."""

from parking_exp.buffers.her import HerBuffer

__all__ = ["HerBuffer"]
