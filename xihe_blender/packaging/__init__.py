"""The extension as a zip, from a checkout."""
