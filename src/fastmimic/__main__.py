"""`python -m fastmimic` is the command `fastmimic`."""

import sys

from fastmimic.cli import main

sys.exit(main())
