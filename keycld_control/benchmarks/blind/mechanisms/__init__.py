"""The mechanisms of the taxonomy, and some outside it, in formulas of their own."""
