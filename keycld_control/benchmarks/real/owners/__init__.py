"""What owners of the real recordings identified of their mechanisms, as simulators with effects."""
