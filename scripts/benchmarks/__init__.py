"""Speed benchmarks relative to named peers."""
