"""Exercises for students: declarations, what is measured in the live cell, and result sheets."""
