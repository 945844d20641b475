"""The paper's law by its equations, the completed law, the shield."""
