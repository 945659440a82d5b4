"""`python -m xihe_blender` is the `xihe` command."""

from xihe_blender.cli.main import command

# Processes that Dask starts import this file, under another name.
if __name__ == "__main__":
    command()
