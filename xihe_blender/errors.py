"""What goes wrong because of what the user gave, said in one line that names the fix."""


class UserError(Exception):
    """A mistake of the user's. Command line: the message and exit 2. Operator: the message in red and CANCELLED."""
