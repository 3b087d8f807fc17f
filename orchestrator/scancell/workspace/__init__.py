"""Seeing a recorded run: pictures and animations of the cell, rendered by the project's own ray tracer."""
