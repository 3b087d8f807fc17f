"""What the sensor can see of a part: measurable surface and occlusion."""
