"""Finds physics that a simulator lacks, from recordings of joints."""

from keycld_model.diagnosis.corrected import write_corrected
from keycld_model.diagnosis.diagnose import diagnose
from keycld_model.diagnosis.evidence import Evidence
from keycld_model.diagnosis.page import write_page
from keycld_model.diagnosis.report import Report
from keycld_model.diagnosis.source import Source

__all__ = ["Evidence", "Report", "Source", "diagnose", "write_corrected", "write_page"]
