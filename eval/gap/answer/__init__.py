"""The diagnosis of flights: names, errors before and after, identification."""
