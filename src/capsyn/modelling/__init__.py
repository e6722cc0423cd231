"""The user's words: domain, alphabet, settings, target, problem; CasADi to programs."""
