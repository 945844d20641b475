"""How a motion follows what is asked of it: the path between samples, turns, waypoints, the goal at its end."""
