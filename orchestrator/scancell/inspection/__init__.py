"""Inspection of CAD parts: features, datums, characteristics, uncertainty and decisions."""
