#!/usr/bin/env python
"""Measure speed as ratios, side by side; see --help."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from parking_exp.cli.benchmark import main

if __name__ == "__main__":
    main()
