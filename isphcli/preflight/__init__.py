"""What a careful colleague says about a case before it runs."""
