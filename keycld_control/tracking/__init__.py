"""What `keycld track` writes: a recording, a clip with the track drawn over it, and a page."""

from keycld_control.tracking.save import save

__all__ = ["save"]
