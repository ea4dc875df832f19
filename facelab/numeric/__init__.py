"""What the mathematics of faces rests on, and nothing of faces in it."""
