#!/usr/bin/env python
"""Evaluate trained agents again, e.g. on other tasks; see --help."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from parking_exp.cli.evaluate import main

if __name__ == "__main__":
    main()
