"""The cell as its descriptions say it is: bodies, frames and kinematics."""
