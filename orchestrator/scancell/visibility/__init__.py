"""Visibility of a part to the sensor: measurable surface and occlusion."""
