"""Words, files and pages for people."""
