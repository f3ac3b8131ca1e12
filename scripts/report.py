#!/usr/bin/env python
"""Compare the cells of an experiment; see --help."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from parking_exp.cli.report import main

if __name__ == "__main__":
    main()
