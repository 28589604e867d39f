"""Times and rates of this machine, for the tables of the documents."""
