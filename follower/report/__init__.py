"""The flight report: what happened, how well it went, how to do it again."""

from follower.report.meta import ReportMeta
from follower.report.writer import write_report, write_score, write_whole

__all__ = ["ReportMeta", "write_report", "write_score", "write_whole"]
