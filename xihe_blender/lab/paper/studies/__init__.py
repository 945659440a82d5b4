"""Studies, one module per table or figure of the paper; each has a `STUDY`, and is found because it is here."""
