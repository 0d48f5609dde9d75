"""Finds physics that a simulator lacks, from recordings of joints or images."""

from keycld_model.diagnosis.diagnose import diagnose
from keycld_model.diagnosis.from_images import diagnose_by_world_model, diagnose_images, learned_simulator
from keycld_model.diagnosis.inputs.source import Source
from keycld_model.diagnosis.output.joint_model import write_corrected_joint_model
from keycld_model.diagnosis.output.mjcf import write_corrected
from keycld_model.diagnosis.output.page import write_page
from keycld_model.diagnosis.verdict.evidence import Evidence
from keycld_model.diagnosis.verdict.report import Report

__all__ = [
    "Evidence",
    "Report",
    "Source",
    "diagnose",
    "diagnose_by_world_model",
    "diagnose_images",
    "learned_simulator",
    "write_corrected",
    "write_corrected_joint_model",
    "write_page",
]
