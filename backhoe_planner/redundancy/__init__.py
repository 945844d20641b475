"""The paper's law, its completion, and the shield that keeps it safe."""
