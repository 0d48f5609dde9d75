"""Finds physics that a simulator lacks, from recordings of joints."""

from keycld_model.diagnosis.diagnose import diagnose
from keycld_model.diagnosis.report import Report

__all__ = ["Report", "diagnose"]
