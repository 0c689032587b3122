"""The verdict, what remains unexplained, and the next measurement."""
