"""The page of `keycld detectable`."""
