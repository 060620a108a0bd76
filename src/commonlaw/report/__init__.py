"""Reports: what was asked, done and found, as one self-contained page with its figures and numbers beside it."""

from commonlaw.report.document import Block, Picture, Report, Section, Table, Text, Verdict
from commonlaw.report.values import to_json
from commonlaw.report.write import contents, write_report

__all__ = ["Block", "Picture", "Report", "Section", "Table", "Text", "Verdict", "contents", "to_json", "write_report"]
