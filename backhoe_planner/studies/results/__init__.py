"""The folder of results: the journal, the tables, and their summary."""
