"""How a motion follows its task: the path between samples, turns, waypoints, the goal at its end."""
