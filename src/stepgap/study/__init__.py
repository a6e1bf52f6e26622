"""What the error of a run says of its robot, and how robots of one type differ."""
