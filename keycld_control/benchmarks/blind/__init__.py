"""Sealed cases with known missing physics, diagnoses of them, and the score; see docs/blind.md."""
