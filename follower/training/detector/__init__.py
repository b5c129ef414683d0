"""Training of a detector of the YOLO v2 family."""
