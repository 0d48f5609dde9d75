"""What others would say that changed between two sets of recordings, asked the same question as the diagnosis."""
