"""From a machine and a scene to a motion with a verdict."""
