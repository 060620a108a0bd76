"""Reports: what was asked, done and found, as one self-contained page, with its figures and numbers as files."""

from commonlaw.report.document import Block, Fold, Gallery, Picture, Report, Section, Table, Text, Verdict, to_json
from commonlaw.report.law_report import law_page, law_report
from commonlaw.report.notebook import notebook_html
from commonlaw.report.write import check_packages, contents, to_page, write_report

__all__ = [
    "Block",
    "Fold",
    "Gallery",
    "Picture",
    "Report",
    "Section",
    "Table",
    "Text",
    "Verdict",
    "check_packages",
    "contents",
    "law_page",
    "law_report",
    "notebook_html",
    "to_json",
    "to_page",
    "write_report",
]
