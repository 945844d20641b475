"""What the machine is: the URDF, kinematics, dynamics, and its collision shape."""
