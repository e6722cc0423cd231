"""Better policies from policies, judged in closed loop."""
