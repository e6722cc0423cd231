"""Control alphabet policies: lookup, file, picture, report."""
