"""A camera with a laser line on a robot, from images of a chessboard with the stripe on it."""
