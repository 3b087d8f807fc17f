"""The nominal cell, from its descriptions: bodies, frames and kinematics."""
