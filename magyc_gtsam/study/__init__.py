"""Monte-Carlo studies: the bound, the papers' tables, and how close the methods come."""
