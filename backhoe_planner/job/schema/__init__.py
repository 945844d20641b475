"""The records of the job file, by what they describe."""
