"""A diagnosis as a page for people: one HTML file that needs nothing else."""

from keycld_model.diagnosis.output.page.page import write_page

__all__ = ["write_page"]
