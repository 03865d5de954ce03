"""``python -m fewrays``: the same as the ``fewrays`` command."""

import sys

from fewrays.cli import main

sys.exit(main())
