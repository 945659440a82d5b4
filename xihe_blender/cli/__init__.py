"""The `xihe` command: one file per sub-command."""
