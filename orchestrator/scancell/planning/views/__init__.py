"""Views of the part, sensor paths, and what they see."""
