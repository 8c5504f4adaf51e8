"""`python -m glissando` is the command line."""

import sys

from glissando.cli import main

sys.exit(main())
