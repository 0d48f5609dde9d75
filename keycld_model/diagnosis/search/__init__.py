"""Which effects explain what the refitted simulator cannot."""
