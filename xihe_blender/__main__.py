"""`python -m xihe_blender` is the `xihe` command."""

import sys

from xihe_blender.cli.main import main

# Processes that Dask starts import this file, under another name.
if __name__ == "__main__":
    sys.exit(main())
