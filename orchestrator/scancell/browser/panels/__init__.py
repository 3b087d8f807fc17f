"""Displays and inputs of the workspace."""
