"""Files checked as the programs that import them would."""
