"""Views of the part, sensor paths, and the surface that they see."""
