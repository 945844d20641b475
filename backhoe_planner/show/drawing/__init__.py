"""Machine and site as meshes of a viewer."""
