"""Replay buffers."""

from parking_exp.buffers.her import HerBuffer

__all__ = ["HerBuffer"]
