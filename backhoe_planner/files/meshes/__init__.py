"""What files of meshes say, and what programs that read them leave out."""
