"""`python -m glissando` is the command line."""

import sys

from glissando.cli.main import main

sys.exit(main())
