"""The parts of the checker of certificates, which share nothing with what makes them."""
