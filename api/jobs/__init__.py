"""Long work: a table of jobs in any SQL database, files in a store, threads that carry it out."""
