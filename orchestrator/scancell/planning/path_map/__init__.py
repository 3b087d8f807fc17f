"""Configuration maps of sensor paths, and motions of the table along them."""
