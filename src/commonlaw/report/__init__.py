"""Reports: what was asked, done and found, as one self-contained page."""

from commonlaw.report.document import (
    Block,
    Fold,
    Gallery,
    Picture,
    Report,
    Section,
    Table,
    Text,
    check_packages,
    to_page,
)
from commonlaw.report.law_report import law_page, law_report
from commonlaw.report.notebook import notebook_html

__all__ = [
    "Block",
    "Fold",
    "Gallery",
    "Picture",
    "Report",
    "Section",
    "Table",
    "Text",
    "check_packages",
    "law_page",
    "law_report",
    "notebook_html",
    "to_page",
]
