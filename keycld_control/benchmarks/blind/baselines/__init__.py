"""What others would do with the same recordings, measured beside the diagnosis."""
