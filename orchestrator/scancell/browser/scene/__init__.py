"""The scene of the cell in a browser."""
