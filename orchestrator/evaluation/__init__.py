"""Figures and pictures that say how good a cloud is."""
