"""A diagnosis as a page for people: one HTML file that needs nothing else."""

from keycld_model.diagnosis.output.page.page import html_page, write_page

__all__ = ["html_page", "write_page"]
