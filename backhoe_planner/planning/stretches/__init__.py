"""What becomes of a resolved stretch of a path: smoother, cheaper, with round corners, timed."""
