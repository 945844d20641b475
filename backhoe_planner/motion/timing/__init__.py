"""The timing of motions: as fast as the limits allow."""
