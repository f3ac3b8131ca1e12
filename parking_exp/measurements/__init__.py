"""What scripts/benchmark.py measures: speed, as ratios against named peers."""
