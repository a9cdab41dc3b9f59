"""`python -m inclined_landing.eval` is `landing-eval`."""

import sys

from inclined_landing.eval.cli import main

sys.exit(main())
