"""Commands of the reports in ``docs/results``, and the tables that documents show of them."""
