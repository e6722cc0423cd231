"""Trees whose splits compare features, functions of the state that the user names."""
