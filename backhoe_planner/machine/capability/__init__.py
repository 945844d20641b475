"""What a machine can do: envelope, digging forces, Denavit-Hartenberg table."""
