"""The cell in browsers, by viser."""
