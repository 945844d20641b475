"""The rows of a study: what differs, where it stands, and what is kept of each plan."""
