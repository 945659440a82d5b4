"""Files that a run leaves: their names, radiance, provenance, and whose a folder is."""
