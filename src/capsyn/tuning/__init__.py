"""Free settings of problems, and the search for those that meet a goal."""
