"""The report of a run: one self-contained HTML file. Pictures first, then plots, then numbers. Knows no Blender."""

from xihe_blender.report.page import write_report

__all__ = ["write_report"]
