"""The KeyCLD paper anew: what is trained, what is measured, and the page that shows it."""
