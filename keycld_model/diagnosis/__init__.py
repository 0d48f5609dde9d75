"""Finds physics that a simulator lacks, from recordings."""
