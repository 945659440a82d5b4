"""The report of a run: one self-contained HTML file. Pictures first, then plots, then numbers. Knows no Blender."""
