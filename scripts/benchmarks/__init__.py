"""Speed benchmarks: ratios against named peers, measured in turn."""
