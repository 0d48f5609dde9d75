"""What changed since a baseline, or helps in all of one set, beside forces that nothing explains."""
