"""`python -m xihe_blender` is the `xihe` command."""

import sys

from xihe_blender.cli import main

sys.exit(main())
