"""A cell that runs while operators command it."""
