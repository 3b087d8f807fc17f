"""Robot programs."""
