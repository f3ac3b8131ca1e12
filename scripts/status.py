#!/usr/bin/env python
"""Show how far runs are; see --help."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from parking_exp.cli.status import main

if __name__ == "__main__":
    main()
