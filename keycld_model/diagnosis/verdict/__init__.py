"""What may be said of it, and how surely."""
