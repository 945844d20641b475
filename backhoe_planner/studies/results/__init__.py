"""The folder of results: the journal, the tables, and what they say."""
