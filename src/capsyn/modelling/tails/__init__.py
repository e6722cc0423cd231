"""Terminal costs that stand for the cost to go."""
