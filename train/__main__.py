"""`python -m inclined_landing.train`."""

import sys

from inclined_landing.train.cli import main

sys.exit(main())
