"""The servo: wishes in, motions out that are always safe."""
