"""What a browser shows of the cell."""
