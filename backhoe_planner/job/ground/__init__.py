"""The ground as it is at a moment of a job: what the bucket takes out of it, and where loose soil comes to rest."""
