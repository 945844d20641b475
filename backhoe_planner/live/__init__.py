"""Moving the machine live."""
