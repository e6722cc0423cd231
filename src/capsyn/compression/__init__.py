"""From policies to small decision trees."""
