"""Ways in joint space whose every motion is proven."""
