"""Panels of the browser: each is made once for each browser, and shows the state of the cell."""
