"""Reports: what was asked, done and found, as one self-contained page with its figures and numbers beside it."""

from commonlaw.report.blocks import Block, Picture, Table, Text
from commonlaw.report.document import Report, Section
from commonlaw.report.values import to_json
from commonlaw.report.verdict import Verdict
from commonlaw.report.write import contents, write_report

__all__ = ["Block", "Picture", "Report", "Section", "Table", "Text", "Verdict", "contents", "to_json", "write_report"]
